"""Bound on the false-match probability. Sunsat's chain uses it in addition to the document's "largest group" criterion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtrc

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.results import Centroids
from gss.pipeline.chains.modes import Mode
from gss.pipeline.chains.proof import solid_angle_sr
from gss.pipeline.chains.sunsat_detect import magnitudes
from gss.pipeline.chains.sunsat_match import SunsatCatalogue, SunsatMatching, near_boresight
from gss.pipeline.chains.sunsat_parameters import SunsatParameters
from gss.pipeline.identify.accidental import accidental_bound

Rows = NDArray[np.intp]
# A star that confirms an attitude lies within two distance tolerances of a guide star of its magnitude. Directions that
# satisfy two distances within ±d lie in a parallelogram with the area (2d)² divided by the sine of its angle. This area
# is smaller than the circle unless the angle is below 20°. The mirror test rejects the mirrored solution.
CONFIRM_TOLERANCES = 2.0
# A predicted star is detected if a centroid, possibly a blend, is within SEEN_PX. It is at its predicted position if a
# centroid is within THERE_TOLERANCES distance tolerances. A star within SURE_MARGIN_PX of the border can be cut off.
SEEN_PX, SURE_MARGIN_PX, THERE_TOLERANCES = 6.0, 10.0, 3.0


def confirmed(
    matching: SunsatMatching,
    centroids: Centroids,
    cam_from_icrs: Array,
    visible: Rows,
    camera: Camera,
    catalogue: SunsatCatalogue,
    p: SunsatParameters,
) -> tuple[Rows, Rows]:
    """Return the indices of unmatched centroids that coincide with predicted ``visible`` guide stars, and the rows of
    those stars. The nearest pairs are assigned first, and each guide star is used only once."""
    unmatched = np.setdiff1d(np.arange(len(centroids)), matching.selected)
    visible = np.setdiff1d(visible, matching.row[matching.selected])
    if not len(unmatched) or not len(visible):
        return np.empty(0, np.intp), np.empty(0, np.intp)
    unit = camera.unproject(centroids.pixels[unmatched])
    off = np.linalg.norm(unit[:, None] - (catalogue.guides.unit[visible] @ cam_from_icrs.T)[None], axis=-1)
    fainter = magnitudes(centroids.flux_dn[unmatched], p)[:, None] - catalogue.guides.v_mag[visible][None]
    off[~(np.abs(fainter) <= p.magnitude_tolerance_mag)] = np.inf
    guide = np.argmin(off, axis=1)
    miss = off[np.arange(len(unmatched)), guide]
    order = np.argsort(miss, kind="stable")
    order = order[miss[order] <= CONFIRM_TOLERANCES * p.distance_tolerance_rad]
    _, first = np.unique(guide[order], return_index=True)
    order = order[np.sort(first)]
    return unmatched[order], visible[guide[order]]


def in_view(catalogue: SunsatCatalogue, camera: Camera, cam_from_icrs: Array) -> Rows:
    """Return the rows of the guide stars on the detector."""
    near = np.flatnonzero(near_boresight(catalogue, cam_from_icrs[2], camera.half_diagonal_rad))
    return near[camera.contains(camera.project(catalogue.guides.unit[near] @ cam_from_icrs.T))]


@dataclass(frozen=True)
class Census:
    """Numbers of bright guide stars: ``expected`` to be detected, ``absent`` without any centroid nearby, and ``displaced`` with a
    centroid nearby but not at the right position."""

    expected: int
    absent: int
    displaced: int


def census(
    cam_from_icrs: Array,
    looked_for: Rows,
    centroids: Centroids,
    camera: Camera,
    catalogue: SunsatCatalogue,
    p: SunsatParameters,
) -> Census:
    """Count the expected guide stars that are absent or displaced. Among the guide stars ``looked_for``, only stars
    that must be detectable are counted. These have a suitable brightness, are away from the border, and are not beyond
    the end of a scan that stopped early."""
    guides = catalogue.guides
    bright = (guides.v_mag[looked_for] <= p.sure_mag) & (guides.v_mag[looked_for] >= p.saturating_mag)
    pixels = camera.project(guides.unit[looked_for[bright]] @ cam_from_icrs.T)
    pixels = pixels[camera.contains(pixels, SURE_MARGIN_PX)]
    if len(centroids) >= p.max_found:
        pixels = pixels[pixels[:, 1] < np.max(centroids.row_px) - SURE_MARGIN_PX]
    if not len(pixels):
        return Census(0, 0, 0)
    off = np.linalg.norm(pixels[:, None] - centroids.pixels[None], axis=-1).min(axis=1)
    absent = off > SEEN_PX
    displaced = ~absent & (off > THERE_TOLERANCES * p.distance_tolerance_rad / camera.pixel_rad)
    return Census(len(pixels), int(np.count_nonzero(absent)), int(np.count_nonzero(displaced)))


def false_match_probability(
    matching: SunsatMatching,
    centroids: Centroids,
    confirming: int,
    visible: int,
    camera: Camera,
    catalogue: SunsatCatalogue,
    parameters: SunsatParameters,
) -> float:
    """Return a bound on the expected number of accidental identifications with as many matched and ``confirming``
    stars.

    Each matching pair of stars defines a hypothesis. Each other star of the frame then coincides by chance with a guide
    star of its magnitude. The probability is computed from the density of guide stars. The larger of two densities is
    used: that in view (``visible`` stars), and that around an average pair, because hypotheses come from dense parts of
    the sky. In tracking, ``hypotheses`` already accounts for the matched stars.
    """
    p, guides, n = parameters, catalogue.guides, len(centroids)
    cap_sr = 2 * np.pi * (1 - np.cos(guides.table.max_rad))
    per_sr = max(1.0, float(visible)) / solid_angle_sr(camera)
    per_sr = max(per_sr, 2 * len(guides.table) / max(1, len(guides.v_mag)) / cap_sr)
    share = magnitude_share(magnitudes(centroids.flux_dn, p), guides.v_mag, p.magnitude_tolerance_mag)
    chance = min(1.0, per_sr * share * np.pi * (CONFIRM_TOLERANCES * p.distance_tolerance_rad) ** 2)
    if matching.mode is Mode.TRACKING:
        unmatched = n - len(matching.selected)
        by_chance = float(bdtrc(confirming - 1, unmatched, chance)) if confirming else 1.0
        return float(min(1.0, matching.hypotheses * by_chance))
    return accidental_bound(matching.hypotheses, len(matching.selected) + confirming, n, chance)


def magnitude_share(observed_mag: Array, guide_mag: Array, tolerance_mag: float) -> float:
    """Return the mean share of the guide stars that fit the observed magnitudes."""
    fits = np.abs(observed_mag[:, None] - guide_mag[None, :]) <= tolerance_mag
    return float(fits.mean()) if fits.size else 1.0

"""The chain of the Sunsat star sensor (Jacobs 1995 ch. 2–4): region growing, match groups, tracking in windows, TRIAD.

Nothing is remembered between calls: what the tracker knows from before comes in as the hint. What the document leaves open,
and what we add against false attitudes, is said for each parameter in ``sunsat_parameters.SOURCES``.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.results import Attitude, Centroids, Matches
from gss.domain.rotation import quaternion_from_matrix
from gss.pipeline.attitude import triad
from gss.pipeline.chains.modes import Hint, Mode
from gss.pipeline.chains.onboard import Detection, Solution
from gss.pipeline.chains.sunsat_detect import brightest, dark_rows_dn, find_stars
from gss.pipeline.chains.sunsat_match import SunsatCatalogue, SunsatMatching, near_boresight, widest_pair
from gss.pipeline.chains.sunsat_parameters import SunsatParameters
from gss.pipeline.identify.accidental import accidental_bound
from gss.pipeline.regions import Pixels

# Directions that keep two distances within ±d lie in a parallelogram of (2d)² over the sine of its angle, which is
# taken as one half; the mirrored one falls in the mirror test.
PARALLELOGRAM = 8.0


def find_in_frame(pixels: Pixels, parameters: SunsatParameters) -> Detection:
    """Stars in a whole frame (Jacobs 1995 §2.2)."""
    dark_dn = dark_rows_dn(pixels, parameters.dark_clip_dn, parameters.search_step_px)
    found = find_stars(pixels.astype(np.float32) - dark_dn.astype(np.float32)[:, None], parameters)
    centroids = found.centroids.take(brightest(found.centroids))
    notes = (found.stopped,) if found.stopped else ()
    return Detection(found.regions, centroids, found.invalid, float(np.median(dark_dn)), notes)


def calculate_attitude(
    matching: SunsatMatching,
    centroids: Centroids,
    camera: Camera,
    catalogue: SunsatCatalogue,
    parameters: SunsatParameters,
    hint: Hint | None = None,
) -> Solution:
    """TRIAD on the two matched stars farthest apart (§4.1.6.1), and the checks that keep a false attitude from leaving the
    chain: every matched star must fit, the boresight must be where the hint allows, an accident must be improbable."""
    p, chosen = parameters, matching.selected
    if matching.reason:
        return Solution(None, None, float("nan"), matching.reason)
    rows, unit = matching.row[chosen], matching.unit_cam[chosen]
    reference = catalogue.guides.unit[rows]
    pair = np.searchsorted(chosen, widest_pair(matching.unit_cam, chosen))
    sigma_rad = centroids.sigma_px[chosen] * camera.pixel_rad
    first, second = sorted(pair.tolist(), key=lambda k: (sigma_rad[k], k))
    cam_from_icrs = triad(unit[[first, second]], reference[[first, second]])
    miss_rad = np.linalg.norm(reference @ cam_from_icrs.T - unit, axis=1)
    if np.max(miss_rad) > p.residual_tolerance_rad:
        off_px = float(np.max(miss_rad)) / camera.pixel_rad
        return Solution(None, None, float("nan"), f"matched stars do not fit one attitude: one is {off_px:.1f} px off")
    probability = false_match_probability(matching, cam_from_icrs, camera, catalogue, p)
    reason = _off_hint(matching.mode, hint, cam_from_icrs, p) or _too_probable(probability, matching, p)
    if reason:
        return Solution(None, None, probability, reason)
    covariance = triad_covariance_rad2(unit[first], unit[second], sigma_rad[first], sigma_rad[second])
    residual_px = centroids.pixels[chosen] - camera.project(reference @ cam_from_icrs.T)
    matches = Matches(
        chosen.astype(np.int32), catalogue.bank.hip[rows].astype(np.int32), matching.weight[chosen], residual_px
    )
    return Solution(Attitude(quaternion_from_matrix(cam_from_icrs), covariance), matches, probability, "")


def triad_covariance_rad2(first: Array, second: Array, sigma_first_rad: float, sigma_second_rad: float) -> Array:
    """(3, 3) covariance of the rotation vector, camera frame, of TRIAD with ``first`` met exactly (Shuster and Oh 1981)."""
    across2 = float(np.sum(np.cross(first, second) ** 2))
    mixed = np.outer(first, second) + np.outer(second, first)
    about = sigma_first_rad**2 * float(first @ second) * mixed
    about += (sigma_second_rad**2 - sigma_first_rad**2) * np.outer(first, first)
    return np.asarray(sigma_first_rad**2 * np.eye(3) + about / across2)


def false_match_probability(
    matching: SunsatMatching,
    cam_from_icrs: Array,
    camera: Camera,
    catalogue: SunsatCatalogue,
    parameters: SunsatParameters,
) -> float:
    """Bound on the expected number of accidental identifications with as many stars as this one.

    Each matching pair of stars places a hypothesis on the sky. Each other observed star then finds by accident a guide star
    of its magnitude where both distances fit, with a probability from the density of guide stars: the larger of that in
    view and that round an average pair, since hypotheses come from where stars are dense. While tracking,
    ``hypotheses`` is the whole bound.
    """
    p = parameters
    if matching.mode is Mode.TRACKING:
        return float(min(1.0, matching.hypotheses))
    guides, n = catalogue.guides, len(matching.row)
    near = guides.unit[near_boresight(catalogue, cam_from_icrs[2], camera.half_diagonal_rad)]
    in_view = np.count_nonzero(camera.contains(camera.project(near @ cam_from_icrs.T)))
    cap_sr = 2 * np.pi * (1 - np.cos(guides.table.max_rad))
    per_sr = max(1.0, float(in_view)) / solid_angle_sr(camera)
    per_sr = max(per_sr, 2 * len(guides.table) / max(1, len(guides.v_mag)) / cap_sr)
    share = magnitude_share(matching.v_mag, guides.v_mag, p.magnitude_tolerance_mag)
    chance = min(1.0, per_sr * share * PARALLELOGRAM * p.distance_tolerance_rad**2)
    return accidental_bound(matching.hypotheses, len(matching.selected), n, chance)


def magnitude_share(observed_mag: Array, guide_mag: Array, tolerance_mag: float) -> float:
    """Mean share of the guide stars that fit the observed magnitudes."""
    fits = np.abs(observed_mag[:, None] - guide_mag[None, :]) <= tolerance_mag
    return float(fits.mean()) if fits.size else 1.0


@lru_cache(maxsize=16)
def solid_angle_sr(camera: Camera) -> float:
    """Solid angle of the field."""
    fov_h, fov_v = camera.fov_rad
    return float(4 * np.arcsin(np.sin(fov_h / 2) * np.sin(fov_v / 2)))


def _too_probable(probability: float, matching: SunsatMatching, p: SunsatParameters) -> str:
    if p.acceptance == "document" or probability <= p.max_false_probability:
        return ""
    return (
        f"{len(matching.selected)} of {len(matching.row)} stars matched could be accidental: "
        f"bound {probability:.1e}, allowed {p.max_false_probability:.0e}"
    )


def _off_hint(mode: Mode, hint: Hint | None, cam_from_icrs: Array, p: SunsatParameters) -> str:
    if mode is not Mode.ASSISTED or hint is None:
        return ""
    boresight = np.asarray(hint.boresight_icrs, float)
    off_rad = float(2 * np.arcsin(np.linalg.norm(boresight / np.linalg.norm(boresight) - cam_from_icrs[2]) / 2))
    if off_rad <= p.hint_error_rad:
        return ""
    return f"boresight is {np.degrees(off_rad):.1f}° from the hint; {np.degrees(p.hint_error_rad):.1f}° allowed"

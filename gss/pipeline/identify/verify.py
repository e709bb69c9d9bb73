"""Verification of an identification: the stars of the whole field are predicted from it, and the detections that match
are counted."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.results import Centroids
from gss.pipeline.identify.false_match import brightness_tail, false_match_probability, match_tail
from gss.pipeline.kernels import kernels
from gss.pipeline.small import best_rotation, distances2, median, standard_deviation
from gss.skytables.cells import CellArrays, sky_cells

RADIUS_SIGMA = 3.5
ROUNDS = 3
COUNT_WITHIN = (1.0, 0.5)
MAX_RADIUS_PX = 25.0
MIN_RADIUS_PX = 0.35
MIN_SIGMA_PX = 0.03
FULL_SHARE = 0.75
"""Share of the stars that a match must have, or it is verified again without each detection from which it began: a false
detection or a companion beside a star rotates the attitude, so that only the stars near the axis match."""
LEAST_FLUX_DN, LARGEST_FLUX_DN = 1e-12, 1e300
_EYE = np.eye(3)
SkyArrays = tuple[Array, Array, CellArrays]
MeasuredArrays = tuple[NDArray[np.intp], Array, Array, Array, Array, Array]


@dataclass(frozen=True)
class SkyCatalogue:
    """The stars a camera can image, brightest first: (n,) Hipparcos numbers, (n, 3) ICRS unit vectors, (n,) V magnitudes."""

    hip: NDArray[np.int32]
    icrs: Array
    v_mag: Array

    def __len__(self) -> int:
        return len(self.hip)

    @cached_property
    def arrays(self) -> SkyArrays:
        """Return the input of the compiled loops: directions, magnitudes, and stars by sky cells."""
        icrs, v_mag = np.ascontiguousarray(self.icrs, float), np.ascontiguousarray(self.v_mag, float)
        return icrs, v_mag, sky_cells(self.icrs).arrays


@dataclass(frozen=True)
class FrameDetections:
    """Detections of one frame, brightest first: rows in Centroids, (n, 2) pixels, (n, 3) camera vectors, their errors, and
    magnitudes with an arbitrary zero point."""

    centroid: NDArray[np.intp]
    pixels: Array
    unit: Array
    sigma_px: Array
    sigma_rad: Array
    magnitude: Array

    def __len__(self) -> int:
        return len(self.pixels)

    @cached_property
    def typical_sigma_px(self) -> float:
        """Return the median position error."""
        return median(self.sigma_px) if len(self) else 0.1

    @property
    def arrays(self) -> tuple[Array, Array, Array, Array, Array]:
        """Return the input of the compiled loops."""
        return self.pixels, self.unit, self.sigma_rad, self.magnitude, self.sigma_px

    @cached_property
    def magnitude_spread(self) -> float:
        """Return the standard deviation of the magnitudes; 0 without detections."""
        return standard_deviation(self.magnitude) if len(self) else 0.0


def field_of(centroids: Centroids, camera: Camera, *, fast: bool | None = None) -> FrameDetections:
    """Convert centroids to a field with the geometry of a known camera. Positions outside the distortion's domain are
    dropped. ``fast``: see :func:`gss.pipeline.kernels.kernels`."""
    loops = kernels(fast).lists
    measured = _measured if loops is None else loops.measured
    return FrameDetections(*measured(camera, centroids))


def _measured(camera: Camera, centroids: Centroids) -> MeasuredArrays:
    """Return the arrays of ``FrameDetections``."""
    pixels, sigma_px = centroids.pixels, np.maximum(centroids.sigma_px, MIN_SIGMA_PX)
    n = len(pixels)
    steps = np.concatenate([pixels, pixels, pixels])
    steps[n : 2 * n, 0] += 0.5
    steps[2 * n :, 1] += 0.5
    unit = camera.unproject(steps) if n else np.zeros((0, 3))
    centre, right, below = unit[:n], unit[n : 2 * n], unit[2 * n :]
    right, below = right - centre, below - centre
    px_rad = 2 * np.sqrt(np.maximum((right * right).sum(1), (below * below).sum(1)))
    sigma_rad = px_rad * sigma_px
    flux_dn = np.asarray(centroids.flux_dn, float)
    magnitude = -2.5 * np.log10(np.fmin(np.fmax(flux_dn, LEAST_FLUX_DN), LARGEST_FLUX_DN))
    rows = np.flatnonzero(np.isfinite(sigma_rad))  # not finite outside the distortion's domain
    return rows, pixels[rows], centre[rows], sigma_px[rows], sigma_rad[rows], magnitude[rows]


@dataclass(frozen=True)
class Evidence:
    """Verified hypothesis: rows of the field and the matching rows of the sky, attitude, number of predicted stars and
    false-match probability."""

    rows: NDArray[np.intp]
    stars: NDArray[np.intp]
    cam_from_icrs: Array
    predicted: int
    false_match_probability: float


def in_view(
    sky: SkyCatalogue, camera: Camera, cam_from_icrs: Array, margin_px: float = 0.0
) -> tuple[NDArray[np.intp], Array]:
    """Return the rows of the catalogue stars on the detector, and their (m, 2) pixels."""
    near = np.flatnonzero(sky.icrs @ cam_from_icrs[2] > reach_cosine(camera))
    pixels = camera.project(sky.icrs[near] @ cam_from_icrs.T)
    inside = camera.contains(pixels, -margin_px)
    return near[inside], pixels[inside]


@lru_cache(maxsize=256)  # of several cameras, each with the focal lengths of other_lens
def reach_cosine(camera: Camera) -> float:
    """Return the cosine of the angle beyond which no star is on the detector. The result is cached, because the corners
    need a Newton iteration."""
    return float(np.cos(min(camera.half_diagonal_rad * 1.02, 1.5)))


def pair_up(predicted: Array, measured: Array, radius: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return the mutually nearest pairs (predicted row, measured row) within the predicted star's radius (p,) px."""
    if not len(predicted) or not len(measured):
        return np.zeros(0, np.intp), np.zeros(0, np.intp)
    d2 = distances2(predicted, measured)
    nearest = d2.argmin(1)
    back = d2.argmin(0)
    p = np.arange(len(predicted))
    ok = (back[nearest] == p) & (d2[p, nearest] <= radius**2)
    return p[ok], nearest[ok]


def verify(
    field: FrameDetections,
    sky: SkyCatalogue,
    camera: Camera,
    *,
    rows: NDArray[np.intp],
    stars: NDArray[np.intp],
    hypotheses: float,
    calibration_px: float = 0.0,
) -> Evidence | None:
    """Verify a hypothesis of a few identified stars by prediction and counting. None if the hypothesis is inconsistent.

    Two stars define the hypothesis, and each further match is evidence. The probability of a coincidence uses the
    radius of the first prediction, before any fit, which would reduce the offsets.
    """
    first_seen, first, first_radius = np.zeros(0, np.intp), np.zeros((0, 2)), np.zeros(0)
    for round_ in range(ROUNDS):
        weights = 1 / field.sigma_rad[rows] ** 2
        cam_from_icrs = best_rotation(field.unit[rows], sky.icrs[stars], weights)
        visible, predicted = in_view(sky, camera, cam_from_icrs)
        if len(visible) < 2:
            return None
        radius = _radius(field, camera, sky.icrs[visible] @ cam_from_icrs.T, field.unit[rows], weights, calibration_px)
        if round_ == 0:
            first_seen, first, first_radius = visible, predicted, radius
        p, m = pair_up(predicted, field.pixels, radius)
        if len(m) < 3:
            return None
        settled = len(m) == len(rows) and (m == rows).all() and (visible[p] == stars).all()
        rows, stars = m, visible[p]
        if settled:
            break  # another round would give the same matches
    spread = float(np.hypot(sky.v_mag[visible].std(), field.magnitude_spread))
    brightness = brightness_tail(field.magnitude[rows], sky.v_mag[stars], spread)
    offset = _first_offset(first_seen, first, first_radius, stars, field.pixels[rows])
    tail = _tail(offset, first_radius, len(field), camera, brightness)
    order = np.argsort(rows)
    return Evidence(rows[order], stars[order], cam_from_icrs, len(visible), false_match_probability(hypotheses, tail))


def _first_offset(
    visible: NDArray[np.intp], places: Array, radius: Array, stars: NDArray[np.intp], pixels: Array
) -> Array:
    """Return the (m,) distances of the matches from their first predictions, in acceptance radii; infinite if not predicted."""
    position = np.minimum(np.searchsorted(visible, stars), len(visible) - 1)
    off = places[position] - pixels
    return np.asarray(np.where(visible[position] == stars, np.sqrt((off * off).sum(1)) / radius[position], np.inf))


def without_one(
    field: FrameDetections,
    sky: SkyCatalogue,
    camera: Camera,
    first: NDArray[np.intp],
    evidence: Evidence,
    hypotheses: float,
) -> Evidence:
    """Verify again without each of the ``first`` three detections, if the match has at least four stars but few of the stars
    in the field. Return the match with most stars, with the first match's false-match probability: the stars of the others
    were selected."""
    best, probability = evidence, evidence.false_match_probability
    if len(evidence.rows) >= FULL_SHARE * min(len(field), evidence.predicted):
        return best
    for left_out in first:
        others = evidence.rows != left_out
        if np.count_nonzero(others) < 3:
            continue
        rows, stars = evidence.rows[others], evidence.stars[others]
        again = verify(field, sky, camera, rows=rows, stars=stars, hypotheses=hypotheses)
        if again is not None and len(again.rows) > len(best.rows) and again.false_match_probability <= probability:
            best = replace(again, false_match_probability=probability)
    return best


def _radius(
    field: FrameDetections, camera: Camera, unit: Array, used: Array, weights: Array, calibration_px: float
) -> Array:
    """Return the acceptance radius of each predicted star, px, from the centroid error and the attitude error at its position."""
    total = float(weights.sum())
    information = (total + 1e-12 * 2 * total) * _EYE - (used * weights[:, None]).T @ used
    covariance = np.linalg.inv(information)
    trace = float(covariance[0, 0] + covariance[1, 1] + covariance[2, 2])
    lever2 = np.maximum(trace - ((unit @ covariance) * unit).sum(1), 0) * (0.75 / camera.pixel_rad**2)
    typical_px = field.typical_sigma_px
    radius = RADIUS_SIGMA * np.sqrt(typical_px**2 + lever2) + calibration_px
    return np.asarray(np.minimum(np.maximum(radius, MIN_RADIUS_PX), MAX_RADIUS_PX))


def _tail(offset: Array, radius: Array, detections: int, camera: Camera, brightness: float) -> float:
    """Return the probability that randomly scattered detections agree this well with the first prediction.

    ``offset``: (m,) distances of the matches from this prediction, in acceptance radii; ``radius``: (p,) px of all
    predicted stars. Two matches are not counted because they define the hypothesis. The coincidences are tested within
    the full radius and within half of it, and the result is corrected for the two tests.
    """
    area_px2 = np.pi * float(np.sort(radius * radius)[2:].sum())
    tails = []
    for part in COUNT_WITHIN:
        chance = min(1.0, part**2 * area_px2 / (camera.columns * camera.rows))
        tails.append(match_tail(int((offset <= part).sum()) - 2, detections - 2, chance, brightness))
    return min(1.0, min(tails) * len(tails))

"""Detection of a wrong focal length: count matching stars over the whole field at focal lengths around the known one.

With a wrong focal length, a few stars in one corner of the field can still match, because their separations agree
within the tolerance. All of these stars can be identified correctly, but the boresight is then wrong by the scale error
multiplied by their distance from the middle. At the correct focal length, many more stars of the bank coincide with
centroids. This module counts these coincidences.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtrc

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.failure_cause import OTHER_FOCAL_LENGTH
from gss.pipeline.identify.verify import pair_up
from gss.pipeline.kernels import kernels
from gss.pipeline.small import Rows, best_rotation, median

# Adjacent scales differ by half a pixel at a distance of 200 px from the middle. With a larger error, matching rarely
# succeeds.
STEP, LARGEST = 0.0025, 0.03
# A calibration error of one step is accepted, because 1.5 px at a distance of 600 px do not make the attitude wrong.
AS_KNOWN = (1 + STEP, 1 - STEP)
OTHERS = tuple(round(1 + sign * k * STEP, 6) for k in range(2, round(LARGEST / STEP) + 1) for sign in (1, -1))
# If this share of the possible matches is reached, the matches cannot all be in one corner.
PLENTY = 0.8
# The first attitude is computed from a few stars, which can be close together. Therefore the search radius grows with
# the distance from these stars according to the attitude error.
ROUNDS = 4
MAX_PX = 30.0
BESIDE_RAD = 0.05
# Probability of rejecting a correct solution by chance. It can be large, because a false attitude is far worse than the
# rejection of one frame.
ACCIDENT = 1e-2


@dataclass(frozen=True)
class CensusField:
    """Centroids and stars whose coincidences are counted. ``pixels``: (n, 2) of all centroids; ``near_icrs``: (m, 3)
    directions of the stars in and around the field; ``camera``: known camera; ``radius_px``: largest distance of a match."""

    pixels: Array
    near_icrs: Array
    camera: Camera
    radius_px: float


def focal_objection(
    pixels: Array,
    matched: Rows,
    icrs_of_matched: Array,
    bank: Array,
    camera: Camera,
    radius_px: float,
    fast: bool | None = None,
) -> str:
    """Return why the camera's focal length cannot be right, or "".

    ``pixels``: (n, 2) of all centroids; ``matched``: (k,) indices of the identified centroids; ``icrs_of_matched``: (k, 3)
    their stars; ``bank``: (m, 3) directions of all stars that the camera can see; ``radius_px``: largest distance of a
    match; ``fast``: see ``kernels.kernels``.
    """
    loops = kernels(fast).lists
    count_matches = _count_matches if loops is None else loops.count_matches
    cam_from_icrs = best_rotation(camera.unproject(pixels[matched]), icrs_of_matched, np.ones(len(matched)))
    near = bank[bank @ cam_from_icrs[2] > np.cos(min(camera.half_diagonal_rad + BESIDE_RAD, np.pi))]
    field = CensusField(pixels, near, camera, radius_px)
    starts = [(matched, icrs_of_matched)]
    if len(matched) > 2:
        inner = _without_furthest(pixels[matched])
        starts.append((matched[inner], icrs_of_matched[inner]))

    at_scale_one = in_view = 0
    for rows, matched_icrs in starts:
        counted = count_matches(field, rows, matched_icrs, (1.0,))[0].tolist()
        at_scale_one, in_view = max((at_scale_one, in_view), (counted[0], counted[1]))
        if plenty(at_scale_one, in_view, len(pixels)):
            return ""
    scales = (*AS_KNOWN, *OTHERS)
    counts = np.max([count_matches(field, *start, scales)[:, 0] for start in starts], axis=0)
    at_scale_one, counts = max(at_scale_one, int(counts[: len(AS_KNOWN)].max())), counts[len(AS_KNOWN) :]
    best = int(np.argmax(counts))
    gain = int(counts[best]) - at_scale_one
    chance = min(1.0, in_view * np.pi * radius_px**2 / (camera.columns * camera.rows))
    if gain <= 0 or len(OTHERS) * float(bdtrc(gain - 1, max(len(pixels) - at_scale_one, gain), chance)) > ACCIDENT:
        return ""
    return (
        f"{at_scale_one} stars of the bank are where the focal length of the camera puts them, "
        f"{counts[best]} where one of {100 * (OTHERS[best] - 1):+.2g} % would: {OTHER_FOCAL_LENGTH}"
    )


def _without_furthest(pixels: Array) -> Rows:
    """Return all rows except the row furthest from the median, which is often a false match."""
    col, row = pixels[:, 0], pixels[:, 1]
    furthest = np.argmax((col - median(col)) ** 2 + (row - median(row)) ** 2)
    return np.flatnonzero(np.arange(len(pixels)) != furthest)


def count_coinciding(
    pixels: Array,
    rows: Rows,
    icrs: Array,
    stars: Rows,
    cam_from_icrs: Array,
    camera: Camera,
    radius_px: float,
    fast: bool | None = None,
) -> int:
    """Return how many identified centroids are at most ``radius_px`` from the predictions of their stars.

    ``pixels``: (n, 2) of all centroids; ``rows``: (k,) identified centroids; ``icrs``: (m, 3) all stars; ``stars``: (k,)
    identified stars; ``cam_from_icrs``: (3, 3). ``fast``: see ``kernels.kernels``, also for the errors that it raises.
    """
    loops = kernels(fast).lists
    count = _count_coinciding if loops is None else loops.count_coinciding
    return count(pixels, rows, icrs, stars, cam_from_icrs, camera, radius_px)


def _count_coinciding(
    pixels: Array, rows: Rows, icrs: Array, stars: Rows, cam_from_icrs: Array, camera: Camera, radius_px: float
) -> int:
    off = camera.project(icrs[stars] @ cam_from_icrs.T) - pixels[rows]
    return int(np.count_nonzero((off * off).sum(1) <= radius_px**2))


def plenty(matched: int, in_view: int, centroids: int) -> bool:
    """True if the share of possible matches is so large that no other focal length needs to be tried."""
    return matched >= PLENTY * min(centroids, in_view)


def _count_matches(field: CensusField, rows: Rows, matched_icrs: Array, scales: tuple[float, ...]) -> NDArray[np.int64]:
    """Return, for each of the s focal lengths, how many stars coincide with centroids and how many are in view: (s, 2).
    ``rows``: (k,) identified centroids; ``matched_icrs``: (k, 3) their stars; ``scales``: ratios to the known focal length."""
    cameras = field.camera.with_focal_scales(scales)
    units = _seen_with(field.camera, scales, field.pixels)
    counts = [_count(field, rows, matched_icrs, *scaled) for scaled in zip(cameras, units, strict=True)]
    return np.array(counts, np.int64)


def _seen_with(camera: Camera, scales: tuple[float, ...], pixels: Array) -> Array:
    """Return the (scales, n, 3) directions of the pixels with each focal length. All distortions are inverted in one call."""
    centre = np.array([camera.centre_col_px, camera.centre_row_px])
    nearer = centre + (pixels - centre) / np.array(scales)[:, None, None]
    return camera.unproject(nearer.reshape(-1, 2)).reshape(len(scales), len(pixels), 3)


def _count(field: CensusField, rows: Rows, matched_icrs: Array, camera: Camera, unit: Array) -> tuple[int, int]:
    """Return how many stars coincide with centroids and how many are in view, after iterating the attitude on the
    matches. ``unit``: (n, 3) directions of the pixels with this ``camera``.

    Centroids outside the domain of the lens model have no direction and are not counted. The iteration has converged if a
    round matches the same stars as the previous round.
    """
    has_direction = np.isfinite(unit[:, 0])
    known = has_direction[rows]
    spots, stars = rows[known], matched_icrs[known]
    if len(spots) < 2:
        return 0, 0
    weight = np.ones(len(spots))
    matched, in_view, settled = 0, 0, False
    identified: Rows = np.empty(0, np.intp)
    for round_ in range(ROUNDS + 1):
        last = settled or round_ == ROUNDS
        predicted = camera.project(field.near_icrs @ best_rotation(unit[spots], stars, weight).T)
        visible = np.flatnonzero(camera.contains(predicted))
        star_px = predicted[visible]
        radius = np.full(len(visible), field.radius_px)
        if not last:
            radius *= _lever(star_px, field.pixels[spots], weight, MAX_PX / field.radius_px)
        star, spot = pair_up(star_px, field.pixels, radius)
        known = has_direction[spot]
        star, spot = star[known], spot[known]
        matched, in_view = len(spot), len(visible)
        if matched < 2 or last:
            break
        stars, weight = field.near_icrs[visible[star]], (field.radius_px / radius[star]) ** 2
        settled = np.array_equal(spot, spots) and np.array_equal(visible[star], identified)
        spots, identified = spot, visible[star]
    return matched, in_view


def _lever(positions: Array, fitted: Array, weight: Array, limit: float) -> Array:
    """Return the (n,) ratios of the prediction error at ``positions`` to the error of one star, at most ``limit``. The
    ratio grows with the distance from the fitted stars."""
    total = float(weight.sum())
    middle = weight @ fitted / total
    extent2 = float(weight @ ((fitted - middle) ** 2).sum(1))
    far2 = ((positions - middle) ** 2).sum(1)
    return np.asarray(np.minimum(np.sqrt(1 + 1 / total + far2 / max(extent2, 1.0)), limit))

"""Detection of a wrong focal length: count matching stars over the whole field at focal lengths around the known one.

With a wrong focal length, a few stars in one corner of the field can still match, because their separations agree
within the tolerance. All of these stars can be identified correctly, but the boresight is then wrong by the scale error
multiplied by their distance from the middle. At the correct focal length, many more stars of the bank coincide with
centroids. This module counts these coincidences.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import bdtrc

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.failure_cause import OTHER_FOCAL_LENGTH
from gss.pipeline.identify.verify import pair_up
from gss.pipeline.kernels import kernels
from gss.pipeline.small import best_rotation, median

Rows = NDArray[np.intp]

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
    known_unit = camera.unproject(pixels)
    cam_from_icrs = best_rotation(known_unit[matched], icrs_of_matched, np.ones(len(matched)))
    near = bank[bank @ cam_from_icrs[2] > np.cos(min(camera.half_diagonal_rad + BESIDE_RAD, np.pi))]
    starts = [(matched, icrs_of_matched)]
    if len(matched) > 2:
        inner = _without_furthest(pixels[matched])
        starts.append((matched[inner], icrs_of_matched[inner]))

    at_scale_one = in_view = 0
    for rows, icrs in starts:
        counted = count_matches(pixels, known_unit[None], rows, icrs, near, camera, (1.0,), radius_px)[0].tolist()
        at_scale_one, in_view = max((at_scale_one, in_view), (counted[0], counted[1]))
        if plenty(at_scale_one, in_view, len(pixels)):
            return ""
    scales = (*AS_KNOWN, *OTHERS)
    seen = _seen_with(camera, scales, pixels)
    counts = [count_matches(pixels, seen, rows, icrs, near, camera, scales, radius_px)[:, 0] for rows, icrs in starts]
    met = np.max(counts, axis=0)
    at_scale_one, met = max(at_scale_one, int(met[: len(AS_KNOWN)].max())), met[len(AS_KNOWN) :]
    best = int(np.argmax(met))
    gain = int(met[best]) - at_scale_one
    chance = min(1.0, in_view * np.pi * radius_px**2 / (camera.columns * camera.rows))
    if gain <= 0 or len(OTHERS) * float(bdtrc(gain - 1, max(len(pixels) - at_scale_one, gain), chance)) > ACCIDENT:
        return ""
    return (
        f"{at_scale_one} stars of the bank are where the focal length of the camera puts them, "
        f"{met[best]} where one of {100 * (OTHERS[best] - 1):+.2g} % would: {OTHER_FOCAL_LENGTH}"
    )


def _seen_with(camera: Camera, scales: tuple[float, ...], pixels: Array) -> Array:
    """Return the (scales, n, 3) directions of the pixels with each focal length. All distortions are inverted in one call."""
    centre = np.array([camera.centre_col_px, camera.centre_row_px])
    nearer = centre + (pixels - centre) / np.array(scales)[:, None, None]
    return camera.unproject(nearer.reshape(-1, 2)).reshape(len(scales), len(pixels), 3)


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
    """Return how many of the (k,) matched ``rows`` of the pixels are within the radius of their predicted ``stars``.
    ``fast``: see ``kernels.kernels``."""
    loops = kernels(fast).lists
    count = _count_coinciding if loops is None else loops.count_coinciding
    return count(pixels, rows, icrs, stars, cam_from_icrs, camera, radius_px)


def _count_coinciding(
    pixels: Array, rows: Rows, icrs: Array, stars: Rows, cam_from_icrs: Array, camera: Camera, radius_px: float
) -> int:
    off = camera.project(icrs[stars] @ cam_from_icrs.T) - pixels[rows]
    return int(np.count_nonzero((off * off).sum(1) <= radius_px**2))


def plenty(met: int, in_view: int, centroids: int) -> bool:
    """True if the share of possible matches is so large that no other focal length needs to be tried."""
    return met >= PLENTY * min(centroids, in_view)


def _count_matches(
    pixels: Array,
    units: Array,
    rows: Rows,
    icrs: Array,
    near: Array,
    camera: Camera,
    scales: tuple[float, ...],
    radius_px: float,
) -> NDArray[np.int64]:
    """Return, for each of the s focal lengths, how many stars coincide with centroids and how many are in view: (s, 2).
    ``units``: (s, n, 3) directions of the pixels with each focal length."""
    cameras = camera.with_focal_lengths(scales)
    counts = [
        _count(pixels, unit, rows, icrs, near, scaled, radius_px) for unit, scaled in zip(units, cameras, strict=True)
    ]
    return np.array(counts, np.int64)


def _count(
    pixels: Array, unit: Array, rows: Rows, icrs: Array, near: Array, camera: Camera, radius_px: float
) -> tuple[int, int]:
    """Return how many stars coincide with centroids and how many are in view, after iterating the attitude on the
    matches.

    ``unit``: (n, 3) directions of the pixels with that camera. The iteration has converged if a round matches the same
    stars as the previous round.
    """
    stars, spots, weight = icrs, rows, np.ones(len(rows))
    matched, in_view, settled = 0, 0, False
    identified: Rows = np.empty(0, np.intp)
    for round_ in range(ROUNDS + 1):
        last = settled or round_ == ROUNDS
        predicted = camera.project(near @ best_rotation(unit[spots], stars, weight).T)
        visible = np.flatnonzero(camera.contains(predicted))
        star_px = predicted[visible]
        radius = np.full(len(visible), radius_px)
        if not last:
            radius *= _lever(star_px, pixels[spots], weight, MAX_PX / radius_px)
        star, spot = pair_up(star_px, pixels, radius)
        matched, in_view = len(spot), len(visible)
        if matched < 2 or last:
            break
        stars, weight = near[visible[star]], (radius_px / radius[star]) ** 2
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

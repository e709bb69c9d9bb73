"""Compiled counts of stars for the detection of a wrong focal length; equivalent to the functions of ``focal_census``."""

# The loops have no type annotations: numba compiles them for the argument types.
# mypy: allow-untyped-defs

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.pipeline.identify.focal_census import MAX_PX, ROUNDS, CensusField
from gss.pipeline.loops import loop
from gss.pipeline.loops.fit import turned
from gss.pipeline.loops.geometry import (
    FOCAL_COL,
    FOCAL_ROW,
    PIXEL_RAD,
    REACH,
    best_rotation,
    camera_numbers,
    contains,
    project,
    unproject,
)
from gss.pipeline.loops.pairing import by_column, pair_up
from gss.pipeline.small import Rows


def count_coinciding(
    pixels: Array, rows: Rows, icrs: Array, stars: Rows, cam_from_icrs: Array, camera: Camera, radius_px: float
) -> int:
    """Return how many identified centroids are within the radius of the predictions of their stars; equivalent to
    ``focal_census._count_coinciding``."""
    pixels, icrs, turn = (np.ascontiguousarray(array, float) for array in (pixels, icrs, cam_from_icrs))
    rows, stars = np.ascontiguousarray(rows, np.int64), np.ascontiguousarray(stars, np.int64)
    return int(_coinciding(camera_numbers(camera), pixels, rows, icrs, stars, turn, float(radius_px)))


@loop
def _coinciding(camera, pixels, rows, icrs, stars, turn, radius_px):
    count = 0
    for k in range(len(rows)):
        r, s = rows[k], stars[k]
        x, y, z = turned(turn, icrs[s, 0], icrs[s, 1], icrs[s, 2])
        col, row = project(camera, x, y, z)
        count += (col - pixels[r, 0]) ** 2 + (row - pixels[r, 1]) ** 2 <= radius_px * radius_px
    return count


def count_matches(field: CensusField, rows: Rows, matched_icrs: Array, scales: tuple[float, ...]) -> NDArray[np.int64]:
    """Return how many stars coincide with centroids and how many are in view, for each focal length: (s, 2). ``rows``: (k,)
    identified centroids; ``matched_icrs``: (k, 3) their stars; equivalent to ``focal_census._count_matches``."""
    pixels, near, icrs = (np.ascontiguousarray(array, float) for array in (field.pixels, field.near_icrs, matched_icrs))
    cameras = _with_focal_scales(camera_numbers(field.camera), np.array(scales))
    counts = np.empty((len(scales), 2), np.int64)
    _counts(cameras, pixels, np.asarray(rows, np.int64), icrs, near, float(field.radius_px), counts)
    return counts


def _with_focal_scales(numbers: Array, scales: Array) -> Array:
    """Return the numbers of the cameras whose focal lengths are multiplied by each of the scales. Their ``REACH`` is NaN,
    because the counts do not need it."""
    cameras = np.tile(numbers, (len(scales), 1))
    cameras[:, FOCAL_COL] *= scales
    cameras[:, FOCAL_ROW] *= scales
    cameras[:, PIXEL_RAD] /= scales
    cameras[:, REACH] = np.nan
    return cameras


@loop
def _counts(cameras, pixels, rows, icrs, near, radius_px, counts):
    order, column = by_column(pixels)
    unit = np.empty((len(pixels), 3))
    for c in range(len(cameras)):
        for k in range(len(pixels)):
            unit[k, 0], unit[k, 1], unit[k, 2] = unproject(cameras[c], pixels[k, 0], pixels[k, 1])
        counts[c, 0], counts[c, 1] = _count(cameras[c], pixels, order, column, unit, rows, icrs, near, radius_px)


@loop
def _count(camera, pixels, order, column, unit, rows, icrs, near, radius_px):
    room = max(len(near), len(rows))
    star, spot, weight = np.empty(room, np.int64), np.empty(room, np.int64), np.empty(room)
    turn = np.empty((3, 3))
    count, is_first, settled = np.int64(0), True, False
    for k in range(len(rows)):
        if not math.isnan(unit[rows[k], 0]):
            spot[count], star[count], weight[count] = rows[k], k, 1.0
            count += 1
    if count < 2:
        return 0, 0
    profile = _profile(unit, spot, icrs, star, weight, count)
    matched = in_view = np.int64(0)
    visible, places = np.empty(len(near), np.int64), np.empty((len(near), 2))
    to, radius = np.empty(len(near), np.int64), np.empty(len(near))
    back = np.empty(len(pixels), np.int64)
    for round_ in range(ROUNDS + 1):
        last = settled or round_ == ROUNDS
        best_rotation(profile, turn)
        in_view = _predicted(camera, turn, near, visible, places)
        if last:
            radius[:in_view] = radius_px
        else:
            _radii(places, in_view, pixels, spot, weight, count, radius_px, radius)
        pair_up(places, radius, in_view, pixels, order, column, to, back)
        matched, same = np.int64(0), not is_first
        for p in range(in_view):
            if to[p] < 0 or math.isnan(unit[to[p], 0]):
                continue
            same = bool(same and matched < count and spot[matched] == to[p] and star[matched] == visible[p])
            spot[matched], star[matched] = to[p], visible[p]
            weight[matched] = (radius_px / radius[p]) ** 2
            matched += 1
        if matched < 2 or last:
            break
        settled = same and matched == count
        count, is_first = matched, False
        profile = _profile(unit, spot, near, star, weight, count)
    return matched, in_view


@loop
def _profile(unit, spot, icrs, star, weight, count):
    """Return the (3, 3) profile matrix of the matches: weighted sum of measured by catalogue direction."""
    profile = np.zeros((3, 3))
    for k in range(count):
        for i in range(3):
            pull = weight[k] * unit[spot[k], i]
            for j in range(3):
                profile[i, j] += pull * icrs[star[k], j]
    return profile


@loop
def _predicted(camera, turn, near, visible, places):
    """Write the rows and pixels of the stars on the detector; return their number."""
    count = 0
    for s in range(len(near)):
        x, y, z = turned(turn, near[s, 0], near[s, 1], near[s, 2])
        col, row = project(camera, x, y, z)
        if contains(camera, col, row, 0.0):
            visible[count], places[count, 0], places[count, 1] = s, col, row
            count += 1
    return count


@loop
def _radii(places, in_view, pixels, spot, weight, count, radius_px, radius):
    """Write the search radius of each star; equivalent to ``focal_census._lever``."""
    total = middle_col = middle_row = extent2 = 0.0
    for k in range(count):
        total += weight[k]
        middle_col += weight[k] * pixels[spot[k], 0]
        middle_row += weight[k] * pixels[spot[k], 1]
    middle_col /= total
    middle_row /= total
    for k in range(count):
        extent2 += weight[k] * ((pixels[spot[k], 0] - middle_col) ** 2 + (pixels[spot[k], 1] - middle_row) ** 2)
    for p in range(in_view):
        far2 = (places[p, 0] - middle_col) ** 2 + (places[p, 1] - middle_row) ** 2
        lever = math.sqrt(1 + 1 / total + far2 / max(extent2, 1.0))
        radius[p] = radius_px * min(lever, MAX_PX / radius_px)

"""Compiled counts of stars for the detection of a wrong focal length; equivalent to the functions of ``focal_census``."""

# The loops have no type annotations: numba compiles them for the argument types.
# mypy: allow-untyped-defs

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.pipeline.identify.focal_census import MAX_PX, ROUNDS
from gss.pipeline.loops import loop
from gss.pipeline.loops.fit import turned
from gss.pipeline.loops.geometry import best_rotation, camera_numbers, contains, project
from gss.pipeline.loops.pairing import by_column, pair_up
from gss.pipeline.small import Rows


def count_coinciding(
    pixels: Array, rows: Rows, icrs: Array, stars: Rows, cam_from_icrs: Array, camera: Camera, radius_px: float
) -> int:
    """Return how many matches are within the radius of their predictions; see ``focal_census._count_coinciding``."""
    pixels, icrs, turn = (np.ascontiguousarray(array, float) for array in (pixels, icrs, cam_from_icrs))
    rows, stars = np.asarray(rows, np.int64), np.asarray(stars, np.int64)
    return int(_coinciding(camera_numbers(camera), pixels, rows, icrs, stars, turn, float(radius_px)))


@loop
def _coinciding(camera, pixels, rows, icrs, stars, turn, radius_px):
    count = 0
    for k in range(len(rows)):
        s = stars[k]
        x, y, z = turned(turn, icrs[s, 0], icrs[s, 1], icrs[s, 2])
        col, row = project(camera, x, y, z)
        count += (col - pixels[rows[k], 0]) ** 2 + (row - pixels[rows[k], 1]) ** 2 <= radius_px * radius_px
    return count


def count_matches(
    pixels: Array,
    units: Array,
    rows: Rows,
    icrs: Array,
    near: Array,
    camera: Camera,
    scales: tuple[float, ...],
    radius_px: float,
) -> NDArray[np.int64]:
    """Return how many stars coincide with centroids and how many are in view, for each focal length. Arguments as in
    ``focal_census._count_matches``."""
    pixels, units, icrs, near = (np.ascontiguousarray(array, float) for array in (pixels, units, icrs, near))
    counts = np.empty((len(scales), 2), np.int64)
    _counts(_numbers(camera, scales), pixels, units, np.asarray(rows, np.int64), icrs, near, float(radius_px), counts)
    return counts


@lru_cache(maxsize=32)
def _numbers(camera: Camera, scales: tuple[float, ...]) -> Array:
    return np.stack([camera_numbers(scaled) for scaled in camera.with_focal_lengths(scales)])


@loop
def _counts(cameras, pixels, units, rows, icrs, near, radius_px, counts):
    for c in range(len(cameras)):
        counts[c, 0], counts[c, 1] = _count(cameras[c], pixels, units[c], rows, icrs, near, radius_px)


@loop
def _count(camera, pixels, unit, rows, icrs, near, radius_px):
    room = max(len(near), len(rows))
    star, spot, weight = np.empty(room, np.int64), np.empty(room, np.int64), np.empty(room)
    turn = np.empty((3, 3))
    order, column = by_column(pixels)
    profile = _profile(unit, rows, icrs, np.arange(len(rows)), np.ones(len(rows)), len(rows))
    count, is_first, settled = len(rows), True, False
    spot[:count] = rows
    weight[:count] = 1.0
    matched = in_view = 0
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
        matched, same = 0, not is_first
        for p in range(in_view):
            if to[p] < 0:
                continue
            same = same and matched < count and spot[matched] == to[p] and star[matched] == visible[p]
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

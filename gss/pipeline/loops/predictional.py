"""Compiled predictional estimate; equivalent to ``predictional.predictional_fit``."""

# The loops have no type annotations: numba compiles them for the argument types.
# mypy: allow-untyped-defs

from __future__ import annotations

import math

import numpy as np

from gss.domain.angles import COSINE_ERROR
from gss.pipeline.loops import loop
from gss.pipeline.loops.fit import rotate, turned
from gss.pipeline.loops.geometry import inverse
from gss.pipeline.track.differential import CONVERGED_RAD, SETTLED_RAD, SINGULAR, STEPS
from gss.pipeline.track.predictional import ROUNDS


@loop
def _in_view(icrs, rows, cosine, turn, near, predicted):
    """List the ``rows`` whose angle from the boresight has a cosine above ``cosine``, and their directions in the camera
    frame. Return the number of rows."""
    count = 0
    for row in rows:
        x, y, z = turned(turn, icrs[row, 0], icrs[row, 1], icrs[row, 2])
        if z > cosine:
            near[count] = row
            predicted[count, 0], predicted[count, 1], predicted[count, 2] = x, y, z
            count += 1
    return count


@loop
def _pair(unit, predicted, count, radius_rad, partner):
    """Write the row of ``predicted`` paired with each measured direction, -1 without partner. Equivalent to
    ``least_distance.pair_least_distance``."""
    limit = 2 * math.sin(radius_rad / 2)
    cosine = 1 - limit * limit / 2 - COSINE_ERROR
    room = 16
    chord, first, second, found = np.empty(room), np.empty(room, np.int64), np.empty(room, np.int64), 0
    for i in range(len(unit)):
        x, y, z = unit[i, 0], unit[i, 1], unit[i, 2]
        for j in range(count):
            if not x * predicted[j, 0] + y * predicted[j, 1] + z * predicted[j, 2] >= cosine:
                continue
            across = (x - predicted[j, 0]) ** 2 + (y - predicted[j, 1]) ** 2 + (z - predicted[j, 2]) ** 2
            if not math.sqrt(across) <= limit:
                continue
            if found == room:
                chord, first = np.concatenate((chord, np.empty(room))), np.concatenate((first, np.empty_like(first)))
                second = np.concatenate((second, np.empty_like(second)))
                room *= 2
            chord[found], first[found], second[found] = math.sqrt(across), i, j
            found += 1
    partner[:] = -1
    taken = np.zeros(count, np.bool_)
    for k in np.argsort(chord[:found], kind="mergesort"):
        if partner[first[k]] < 0 and not taken[second[k]]:
            partner[first[k]] = second[k]
            taken[second[k]] = True


@loop
def _correct(unit, icrs, near, partner, turn):
    """Correct ``turn`` in place from the pairs. Return True if the stars determine it and the corrections converge.
    Equivalent to ``differential.differential_attitude``."""
    profile, normal, undone, pairs = np.zeros((3, 3)), np.zeros((3, 3)), np.empty((3, 3)), 0
    for k in range(len(unit)):
        if partner[k] < 0:
            continue
        star = icrs[near[partner[k]]]
        pairs += 1
        for i in range(3):
            normal[i, i] += 1.0
            for j in range(3):
                profile[i, j] += unit[k, i] * star[j]
                normal[i, j] -= star[i] * star[j]
    if pairs < 2 or np.linalg.eigvalsh(normal)[0] <= SINGULAR * (normal[0, 0] + normal[1, 1] + normal[2, 2]):
        return False
    inverse(normal, undone)
    length = math.inf
    for _ in range(STEPS):
        # The measured directions and the stars, both in the camera frame, give the torque; the inverse of the normal
        # matrix is turned with the attitude.
        torque_x = torque_y = torque_z = 0.0
        for j in range(3):
            torque_x += profile[2, j] * turn[1, j] - profile[1, j] * turn[2, j]
            torque_y += profile[0, j] * turn[2, j] - profile[2, j] * turn[0, j]
            torque_z += profile[1, j] * turn[0, j] - profile[0, j] * turn[1, j]
        a = turn[0, 0] * torque_x + turn[1, 0] * torque_y + turn[2, 0] * torque_z
        b = turn[0, 1] * torque_x + turn[1, 1] * torque_y + turn[2, 1] * torque_z
        c = turn[0, 2] * torque_x + turn[1, 2] * torque_y + turn[2, 2] * torque_z
        x, y, z = turned(turn, *turned(undone, a, b, c))
        rotate(turn, x, y, z)
        length = math.sqrt(x * x + y * y + z * z)
        if length < CONVERGED_RAD:
            break
    return length < SETTLED_RAD


@loop
def _fit(unit, icrs, rows, turn, radii_rad, view_rad, partner):
    """Fit ``turn`` in place and write the row of each measured star's partner, -1 without partner. Return the number of
    comparisons, -1 without a fit."""
    near, predicted = np.empty(len(rows), np.int64), np.empty((len(rows), 3))
    before, star = np.full(len(unit), -2), np.full(len(unit), -1)
    compared = 0
    for step in range(len(radii_rad) + ROUNDS):
        radius_rad = radii_rad[min(step, len(radii_rad) - 1)]
        count = _in_view(icrs, rows, math.cos(view_rad + radius_rad), turn, near, predicted)
        _pair(unit, predicted, count, radius_rad, partner)
        compared += len(unit) * count
        if not _correct(unit, icrs, near, partner, turn):
            return -1
        same = True
        for k in range(len(unit)):
            star[k] = near[partner[k]] if partner[k] >= 0 else -1
            same &= star[k] == before[k]
            before[k] = star[k]
        if same and radius_rad == radii_rad[-1]:
            partner[:] = star
            return compared
    return -1


def fit(unit_cam, icrs, rows, cam_from_icrs, radii_rad, view_rad):
    """Return attitude, measured stars, their rows and the number of comparisons, or None. Arguments as in
    ``predictional.predictional_fit``."""
    turn, row = np.array(cam_from_icrs, float, order="C"), np.empty(len(unit_cam), np.int64)
    compared = _fit(
        np.ascontiguousarray(unit_cam, float), icrs, rows, turn, np.array(radii_rad, float), float(view_rad), row
    )
    if compared < 0:
        return None
    measured = np.flatnonzero(row >= 0)
    return turn, measured, row[measured], compared

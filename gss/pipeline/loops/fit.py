"""Compiled least-squares fit of an attitude with a fixed camera; equivalent to ``refine.refine`` without camera parameters."""

# The loops have no type annotations: numba compiles them for the argument types.
# mypy: allow-untyped-defs

from __future__ import annotations

import math

import numpy as np

from gss.pipeline.loops import loop
from gss.pipeline.loops.geometry import (
    CENTRE_COL,
    CENTRE_ROW,
    FOCAL_COL,
    FOCAL_ROW,
    KIND,
    PINHOLE,
    distort,
    inverse,
    project,
)
from gss.pipeline.loops.small import middle_of
from gss.pipeline.refine import (
    ATTITUDE_DONE,
    BELIEF,
    DISPLACED,
    LEAST_FREEDOM,
    MAX_RAD,
    NOWHERE_PX,
    OUTLIER_SIGMA,
    ROUNDS,
    STEP,
)


@loop
def turned(turn, x, y, z):
    """Return the direction (x, y, z) rotated by ``turn``, in the camera frame."""
    return (
        turn[0, 0] * x + turn[0, 1] * y + turn[0, 2] * z,
        turn[1, 0] * x + turn[1, 1] * y + turn[1, 2] * z,
        turn[2, 0] * x + turn[2, 1] * y + turn[2, 2] * z,
    )


@loop
def slopes(camera, x, y, z):
    """Return the column and row of a direction, and their derivatives with respect to a small rotation: three of the
    column, three of the row. Equivalent to ``refine._projected``."""
    if not z > 1e-6:
        return math.nan, math.nan, math.nan, math.nan, math.nan, math.nan, math.nan, math.nan
    a, b = x / z, y / z
    c0, c1, c2 = -a * b, 1 + a * a, -b
    r0, r1, r2 = -1 - b * b, a * b, a
    if camera[KIND] == PINHOLE:
        u, v, uu, uv, vu, vv = a, b, 1.0, 0.0, 0.0, 1.0
    else:
        u, v = distort(camera, a, b)
        right_u, right_v = distort(camera, a + STEP, b)
        below_u, below_v = distort(camera, a, b + STEP)
        uu, vu = (right_u - u) / STEP, (right_v - v) / STEP
        uv, vv = (below_u - u) / STEP, (below_v - v) / STEP
    fc, fr = camera[FOCAL_COL], camera[FOCAL_ROW]
    return (
        u * fc + camera[CENTRE_COL],
        v * fr + camera[CENTRE_ROW],
        fc * (uu * c0 + uv * r0),
        fc * (uu * c1 + uv * r1),
        fc * (uu * c2 + uv * r2),
        fr * (vu * c0 + vv * r0),
        fr * (vu * c1 + vv * r1),
        fr * (vu * c2 + vv * r2),
    )


@loop
def rotate(turn, x, y, z):
    """Rotate ``turn`` in place by the rotation vector (x, y, z), with the formula of Rodrigues."""
    angle2 = x * x + y * y + z * z
    angle = math.sqrt(angle2)
    half = 0.5 * (math.sin(angle / 2) / (angle / 2) if angle > 0 else 1.0)
    sinc, versed = 2 * half * math.cos(angle / 2), 2 * half * half
    c = 1 - versed * angle2
    m = np.empty((3, 3))
    m[0, 0], m[0, 1], m[0, 2] = c + versed * x * x, versed * x * y - sinc * z, versed * x * z + sinc * y
    m[1, 0], m[1, 1], m[1, 2] = versed * x * y + sinc * z, c + versed * y * y, versed * y * z - sinc * x
    m[2, 0], m[2, 1], m[2, 2] = versed * x * z - sinc * y, versed * y * z + sinc * x, c + versed * z * z
    for k in range(3):
        p, q, r = turn[0, k], turn[1, k], turn[2, k]
        for i in range(3):
            turn[i, k] = m[i, 0] * p + m[i, 1] * q + m[i, 2] * r


@loop
def _inliers(residual, weight, n, displaced, used):
    """Mark the stars within the outlier limit that are not ``displaced``. Return True if any mark changed."""
    scaled = np.empty(n)
    for k in range(n):
        scaled[k] = math.sqrt((residual[k, 0] ** 2 + residual[k, 1] ** 2) * weight[k])
    limit = 1e6
    if n > 4:  # with fewer stars the spread cannot be estimated
        limit = OUTLIER_SIGMA * 1.2 * max(middle_of(scaled, n) / 1.1774, 1.0)
    changed = False
    for k in range(n):
        good = scaled[k] < limit and not displaced[k]
        changed |= good != used[k]
        used[k] = good
    return changed


@loop
def _displaced_star(residual, jacobian, step, weight, used, undone):
    """Return the star that does not fit the attitude given by the others, -1 if every star fits. Equivalent to
    ``refine.displacements``. ``undone``: inverse of the normal matrix."""
    n, good, total = len(residual), 0, 0.0
    offset, decrease = np.empty((n, 2)), np.zeros(n)
    for k in range(n):
        if not used[k]:
            continue
        for axis in range(2):
            offset[k, axis] = residual[k, axis]
            for i in range(3):
                offset[k, axis] -= jacobian[k, axis, i] * step[i]
        good += 1
        total += weight[k] * (offset[k, 0] ** 2 + offset[k, 1] ** 2)
    freedom = 2 * (good - 1) - 3
    if freedom < LEAST_FREEDOM:
        return -1
    for k in range(n):
        if not used[k]:
            continue
        a = b = d = 0.0
        for i in range(3):
            for j in range(3):
                a += jacobian[k, 0, i] * undone[i, j] * jacobian[k, 0, j]
                b += jacobian[k, 0, i] * undone[i, j] * jacobian[k, 1, j]
                d += jacobian[k, 1, i] * undone[i, j] * jacobian[k, 1, j]
        a, b, d = 1 - weight[k] * a, -weight[k] * b, 1 - weight[k] * d
        determinant = a * d - b * b
        if determinant > 1e-9:
            across, down = offset[k, 0], offset[k, 1]
            pull = d * across * across - 2 * b * across * down + a * down * down
            decrease[k] = max(weight[k] * pull / determinant, 0.0)
    worst = np.argmax(decrease)  # its probability is the lowest
    chance = (1 + decrease[worst] / max(total - decrease[worst], freedom)) ** (-freedom / 2)
    return worst if chance < DISPLACED / good else -1


@loop
def fit_attitude(camera, pixels, icrs, sigma_px, turn, residual, weight, covariance):
    """Fit ``turn`` in place to (n, 2) pixels of (n, 3) stars. Write residuals, weights and covariance, and return the rms."""
    n = len(pixels)
    used, displaced = np.ones(n, np.bool_), np.zeros(n, np.bool_)
    jacobian = np.empty((n, 2, 3))
    normal, undone, gradient, step = np.zeros((3, 3)), np.empty((3, 3)), np.zeros(3), np.zeros(3)
    for k in range(n):
        weight[k] = 1 / sigma_px[k] ** 2
    done, left = False, ROUNDS
    while left > 0:
        left -= 1
        for k in range(n):
            x, y, z = turned(turn, icrs[k, 0], icrs[k, 1], icrs[k, 2])
            col, row, a, b, c, d, e, f = slopes(camera, x, y, z)
            across, down = pixels[k, 0] - col, pixels[k, 1] - row
            if not math.isfinite(across + down + a + b + c + d + e + f):
                across, down, a, b, c, d, e, f = NOWHERE_PX, NOWHERE_PX, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
            residual[k, 0], residual[k, 1] = across, down
            jacobian[k, 0, 0], jacobian[k, 0, 1], jacobian[k, 0, 2] = a, b, c
            jacobian[k, 1, 0], jacobian[k, 1, 1], jacobian[k, 1, 2] = d, e, f
        changed = _inliers(residual, weight, n, displaced, used)
        normal[:] = 0.0
        gradient[:] = 0.0
        for k in range(n):
            if used[k]:
                for axis in range(2):
                    for i in range(3):
                        pull = weight[k] * jacobian[k, axis, i]
                        gradient[i] += pull * residual[k, axis]
                        for j in range(3):
                            normal[i, j] += pull * jacobian[k, axis, j]
        inverse(normal, undone)
        for i in range(3):
            step[i] = undone[i, 0] * gradient[0] + undone[i, 1] * gradient[1] + undone[i, 2] * gradient[2]
        largest = max(abs(step[0]), abs(step[1]), abs(step[2]))
        x, y, z = (
            min(max(step[0], -MAX_RAD), MAX_RAD),
            min(max(step[1], -MAX_RAD), MAX_RAD),
            min(max(step[2], -MAX_RAD), MAX_RAD),
        )
        if not math.isfinite(largest):
            break  # fewer than two stars are left
        rotate(turn, x, y, z)
        if largest < ATTITUDE_DONE and not changed:
            worst = _displaced_star(residual, jacobian, step, weight, used, undone)
            if worst < 0:
                done = True
                break
            displaced[worst] = True
            left = ROUNDS
    for k in range(n):
        if done:
            for axis in range(2):
                for i in range(3):
                    residual[k, axis] -= jacobian[k, axis, i] * step[i]
        else:
            x, y, z = turned(turn, icrs[k, 0], icrs[k, 1], icrs[k, 2])
            col, row = project(camera, x, y, z)
            residual[k, 0], residual[k, 1] = pixels[k, 0] - col, pixels[k, 1] - row
    return _summary(normal, residual, used, weight, covariance)


@loop
def _summary(normal, residual, used, weight, covariance):
    """Write the covariance and the final weights, and return the rms residual per axis. Equivalent to
    ``refine._covariance``."""
    good, squares, chi2 = 0, 0.0, 0.0
    for k in range(len(residual)):
        if used[k] and abs(residual[k, 0]) < NOWHERE_PX and abs(residual[k, 1]) < NOWHERE_PX:
            square = residual[k, 0] ** 2 + residual[k, 1] ** 2
            good += 1
            squares += square
            chi2 += square * weight[k]
        else:
            weight[k] = 0.0
    freedom, factor = 2 * good - 3, 1.0
    if freedom > 0:
        factor = chi2 / freedom if chi2 > freedom else (chi2 + BELIEF) / (freedom + BELIEF)
    for i in range(3):
        normal[i, i] *= 1 + 1e-12
    inverse(normal, covariance)
    covariance *= factor
    return math.sqrt(squares / (2 * good)) if good else math.inf

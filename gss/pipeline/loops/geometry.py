"""Compiled geometry: lens models, the best rotation and small matrices."""

# The loops have no type annotations: numba compiles them for the argument types.
# mypy: allow-untyped-defs

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from gss.domain.angles import Array
from gss.domain.camera import (
    CONVERGED,
    INVERSE_ERROR,
    LONGEST_STEP,
    NEWTON_STEPS,
    Brown,
    BrownUndistort,
    Camera,
    Pinhole,
    RadialTilt,
)
from gss.domain.results import Centroids
from gss.pipeline.identify.verify import LARGEST_FLUX_DN, LEAST_FLUX_DN, MIN_SIGMA_PX, MeasuredArrays, reach_cosine
from gss.pipeline.loops import loop

PINHOLE, BROWN, BROWN_UNDISTORT, RADIAL_TILT = range(4)
# Indices of a camera's numbers in the array; the lens model's parameters follow.
KIND, COLUMNS, ROWS, FOCAL_COL, FOCAL_ROW, CENTRE_COL, CENTRE_ROW, PIXEL_RAD, REACH, LENS = range(10)
JACOBI_SWEEPS = 12


@lru_cache(maxsize=256)  # of several cameras, each with the focal lengths of other_lens
def camera_numbers(camera: Camera) -> Array:
    """Return the parameters of a camera as one array for the loops."""
    lens = camera.distortion
    if isinstance(lens, Pinhole):
        kind, values = PINHOLE, []
    elif isinstance(lens, Brown):
        kind, values = BROWN, [lens.k1, lens.k2, lens.p1, lens.p2, lens.k3]
    elif isinstance(lens, BrownUndistort):
        kind, values = BROWN_UNDISTORT, [lens.k1, lens.k2, lens.p1, lens.p2, 0.0]
    elif isinstance(lens, RadialTilt):
        kind, values = RADIAL_TILT, [lens.focal_mm, lens.tilt_max_rad, lens.tilt_direction_rad, *lens.radial]
    else:
        raise TypeError(f"no compiled loop for the lens model {type(lens).__name__}")
    sides = [camera.columns, camera.rows, camera.focal_col_px, camera.focal_row_px]
    middle = [camera.centre_col_px, camera.centre_row_px, camera.pixel_rad, reach_cosine(camera)]
    return np.array([kind, *sides, *middle, *values], float)


@loop
def _brown(camera, x, y):
    k1, k2, p1, p2, k3 = camera[LENS], camera[LENS + 1], camera[LENS + 2], camera[LENS + 3], camera[LENS + 4]
    r2 = x * x + y * y
    radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
    u, v = x * radial, y * radial
    if p1 != 0.0 or p2 != 0.0:
        u += 2 * p1 * x * y + p2 * (r2 + 2 * x * x)
        v += p1 * (r2 + 2 * y * y) + 2 * p2 * x * y
    return u, v


@loop
def _brown_inverse(camera, u, v):
    k1, k2, p1, p2, k3 = camera[LENS], camera[LENS + 1], camera[LENS + 2], camera[LENS + 3], camera[LENS + 4]
    x, y = u, v
    for _ in range(NEWTON_STEPS):
        bent_u, bent_v = _brown(camera, x, y)
        eu, ev = bent_u - u, bent_v - v
        r2 = x * x + y * y
        radial = 1 + r2 * (k1 + r2 * (k2 + r2 * k3))
        slope = 2 * (k1 + r2 * (2 * k2 + 3 * r2 * k3))
        cross = x * y * slope + 2 * p1 * x + 2 * p2 * y
        xx = radial + x * x * slope + 2 * p1 * y + 6 * p2 * x
        yy = radial + y * y * slope + 6 * p1 * y + 2 * p2 * x
        det = xx * yy - cross * cross
        sx, sy = (yy * eu - cross * ev) / det, (xx * ev - cross * eu) / det
        length = math.sqrt(sx * sx + sy * sy)
        damped = min(1.0, LONGEST_STEP / max(length, 1e-300))
        x -= sx * damped
        y -= sy * damped
        if not length > CONVERGED:
            break
    bent_u, bent_v = _brown(camera, x, y)
    if math.sqrt((bent_u - u) ** 2 + (bent_v - v) ** 2) > INVERSE_ERROR:
        return math.nan, math.nan
    return x, y


@loop
def _aberration(camera, r_mm):
    delta, slope, power = 0.0, 0.0, 1.0
    for k in range(LENS + 3, len(camera)):
        slope += camera[k] * (k - LENS - 2) * power
        power *= r_mm
        delta += camera[k] * power
    return delta, slope


@loop
def _tilt(camera, x, y):
    return math.asin(math.sin(camera[LENS + 1]) * math.cos(math.atan2(y, x) - camera[LENS + 2]))


@loop
def distort(camera, x, y):
    """Return the measured position for an ideal position on the tangent plane."""
    kind = camera[KIND]
    if kind == PINHOLE:
        return x, y
    if kind == BROWN:
        return _brown(camera, x, y)
    if kind == BROWN_UNDISTORT:
        return _brown_inverse(camera, x, y)
    ideal, tilt = math.sqrt(x * x + y * y), _tilt(camera, x, y)
    r = ideal
    for _ in range(NEWTON_STEPS):
        delta, slope = _aberration(camera, r * camera[LENS])
        value = math.cos(tilt) * (r - delta / camera[LENS]) - ideal * (1 + r * math.sin(tilt))
        step = value / (math.cos(tilt) * (1 - slope) - ideal * math.sin(tilt))
        r -= step
        if not abs(step) > CONVERGED:
            break
    scale = r / ideal if ideal > 0 else 1.0
    return x * scale, y * scale


@loop
def undistort(camera, u, v):
    """Return the ideal position for a measured position on the tangent plane."""
    kind = camera[KIND]
    if kind == PINHOLE:
        return u, v
    if kind == BROWN:
        return _brown_inverse(camera, u, v)
    if kind == BROWN_UNDISTORT:
        return _brown(camera, u, v)
    r, tilt = math.sqrt(u * u + v * v), _tilt(camera, u, v)
    delta, _ = _aberration(camera, r * camera[LENS])
    ideal = math.cos(tilt) * (r - delta / camera[LENS]) / (1 + r * math.sin(tilt))
    scale = ideal / r if r > 0 else 1.0
    return u * scale, v * scale


@loop
def project(camera, x, y, z):
    """Return the column and row of a direction in the camera frame; NaN behind the camera."""
    if not z > 1e-6:
        return math.nan, math.nan
    u, v = distort(camera, x / z, y / z)
    return u * camera[FOCAL_COL] + camera[CENTRE_COL], v * camera[FOCAL_ROW] + camera[CENTRE_ROW]


@loop
def unproject(camera, col, row):
    """Return the direction in the camera frame for a column and row."""
    x, y = undistort(
        camera, (col - camera[CENTRE_COL]) / camera[FOCAL_COL], (row - camera[CENTRE_ROW]) / camera[FOCAL_ROW]
    )
    length = math.sqrt(x * x + y * y + 1)
    return x / length, y / length, 1 / length


def measured(camera: Camera, centroids: Centroids) -> MeasuredArrays:
    """Return the arrays of ``FrameDetections``; equivalent to ``verify._measured``."""
    c, n = centroids, len(centroids)
    out = np.empty(n, np.intp), np.empty((n, 2)), np.empty((n, 3)), np.empty(n), np.empty(n), np.empty(n)
    # One new array: numba would compile the loop again for columns that are read-only or not contiguous.
    count = _measured(camera_numbers(camera), np.array((c.col_px, c.row_px, c.sigma_px, c.flux_dn), float), *out)
    if count == n:
        return out
    rows, pixels, unit, sigma_px, sigma_rad, magnitude = out
    return rows[:count], pixels[:count], unit[:count], sigma_px[:count], sigma_rad[:count], magnitude[:count]


@loop
def _measured(camera, columns, rows, pixels, unit, sigma_px, sigma_rad, magnitude):
    count = np.int64(0)
    for i in range(columns.shape[1]):
        col, row, error, flux = columns[0, i], columns[1, i], columns[2, i], columns[3, i]
        x, y, z = unproject(camera, col, row)
        longest2 = 0.0
        for half_col, half_row in ((0.5, 0.0), (0.0, 0.5)):
            u, v, w = unproject(camera, col + half_col, row + half_row)
            length2 = (u - x) ** 2 + (v - y) ** 2 + (w - z) ** 2
            if math.isnan(length2) or length2 > longest2:  # NaN, outside the lens's domain, is kept
                longest2 = length2
        error = error if math.isnan(error) else max(error, MIN_SIGMA_PX)
        angle = 2 * math.sqrt(longest2) * error
        if not math.isfinite(angle):
            continue
        flux = LEAST_FLUX_DN if math.isnan(flux) else max(flux, LEAST_FLUX_DN)
        rows[count], sigma_px[count], sigma_rad[count] = i, error, angle
        magnitude[count] = -2.5 * math.log10(min(flux, LARGEST_FLUX_DN))
        pixels[count, 0], pixels[count, 1] = col, row
        unit[count, 0], unit[count, 1], unit[count, 2] = x, y, z
        count += 1
    return count


@loop
def contains(camera, col, row, margin_px):
    """True if a position is on the detector or at most ``margin_px`` outside."""
    low = -margin_px - 0.5
    return col >= low and row >= low and col <= camera[COLUMNS] - 1 - low and row <= camera[ROWS] - 1 - low


@loop
def best_rotation(profile, turn):
    """Write the rotation that maximises the trace of its product with the (3, 3) profile matrix. Equivalent to
    ``small.best_rotation``; uses Davenport's method with a Jacobi iteration."""
    b = profile
    a, v = np.empty((4, 4)), np.eye(4)
    sigma = b[0, 0] + b[1, 1] + b[2, 2]
    for i in range(3):
        for k in range(3):
            a[i, k] = b[i, k] + b[k, i]
        a[i, i] -= sigma
    a[0, 3] = a[3, 0] = b[2, 1] - b[1, 2]
    a[1, 3] = a[3, 1] = b[0, 2] - b[2, 0]
    a[2, 3] = a[3, 2] = b[1, 0] - b[0, 1]
    a[3, 3] = sigma
    for _ in range(JACOBI_SWEEPS):
        off = size = 0.0
        for i in range(4):
            size += a[i, i] * a[i, i]
            for k in range(i + 1, 4):
                off += a[i, k] * a[i, k]
        if off <= 1e-34 * size:
            break
        for i in range(3):
            for k in range(i + 1, 4):
                if a[i, k] == 0.0:
                    continue
                theta = (a[k, k] - a[i, i]) / (2 * a[i, k])
                t = (1.0 if theta >= 0 else -1.0) / (abs(theta) + math.sqrt(theta * theta + 1))
                c = 1 / math.sqrt(t * t + 1)
                s = t * c
                for m in range(4):
                    p, q = a[m, i], a[m, k]
                    a[m, i], a[m, k] = c * p - s * q, s * p + c * q
                for m in range(4):
                    p, q = a[i, m], a[k, m]
                    a[i, m], a[k, m] = c * p - s * q, s * p + c * q
                    p, q = v[m, i], v[m, k]
                    v[m, i], v[m, k] = c * p - s * q, s * p + c * q
    best = 0
    for i in range(1, 4):
        if a[i, i] > a[best, best]:
            best = i
    x, y, z, w = v[0, best], v[1, best], v[2, best], v[3, best]
    turn[0, 0], turn[0, 1], turn[0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)
    turn[1, 0], turn[1, 1], turn[1, 2] = 2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)
    turn[2, 0], turn[2, 1], turn[2, 2] = 2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)


def mirror_miss_rad(measured_cam: Array, reference_icrs: Array) -> float:
    """Return the largest distance from the mirror image; equivalent to ``soundness._mirror_miss_rad``."""
    unit, icrs = (np.ascontiguousarray(array, float) for array in (measured_cam, reference_icrs))
    return float(_mirror_miss_rad(unit, icrs))


@loop
def _mirror_miss_rad(unit, icrs):
    profile, turn = np.zeros((3, 3)), np.empty((3, 3))
    for k in range(len(unit)):
        for i in range(3):
            for j in range(3):
                profile[i, j] -= unit[k, i] * icrs[k, j]
    best_rotation(profile, turn)
    largest2 = 0.0
    for k in range(len(unit)):
        miss2 = 0.0
        for i in range(3):
            miss2 += (turn[i, 0] * icrs[k, 0] + turn[i, 1] * icrs[k, 1] + turn[i, 2] * icrs[k, 2] + unit[k, i]) ** 2
        largest2 = max(largest2, miss2)
    return math.sqrt(largest2)


@loop
def inverse(m, out):
    """Write the inverse of a symmetric (3, 3) matrix to ``out``."""
    a, b, c, d, e, f = m[0, 0], m[0, 1], m[0, 2], m[1, 1], m[1, 2], m[2, 2]
    p, q, r = d * f - e * e, c * e - b * f, b * e - c * d
    det = a * p + b * q + c * r
    out[0, 0], out[0, 1], out[0, 2] = p / det, q / det, r / det
    out[1, 0], out[1, 1], out[1, 2] = q / det, (a * f - c * c) / det, (b * c - a * e) / det
    out[2, 0], out[2, 1], out[2, 2] = r / det, (b * c - a * e) / det, (a * d - b * b) / det

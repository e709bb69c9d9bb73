"""Numeric helpers for small arrays, called many times per frame. For a dozen numbers, the overhead of general functions
would exceed the computation."""

from __future__ import annotations

import numpy as np

from gss.domain.angles import Array


def median(values: Array) -> float:
    """Return the median of (n ≥ 1) finite numbers."""
    ordered = np.sort(values)
    n = len(ordered)
    return float(ordered[n // 2]) if n % 2 else 0.5 * (float(ordered[n // 2 - 1]) + float(ordered[n // 2]))


def best_rotation(unit: Array, icrs: Array, weight: Array) -> Array:
    """Return the (3, 3) cam_from_icrs that best maps (n, 3) stars to measured directions with (n,) weights. Equals
    ``attitude.svd`` without validation: the directions must be finite and not all parallel."""
    u, _, vt = np.linalg.svd((weight[:, None] * unit).T @ icrs)
    if determinant(u) * determinant(vt) < 0:
        u[:, 2] *= -1
    return np.asarray(u @ vt)


def determinant(matrix: Array) -> float:
    """Return the determinant of a (3, 3) matrix."""
    (a, b, c), (d, e, f), (g, h, i) = matrix.tolist()
    return float(a * (e * i - f * h) - b * (d * i - f * g) + c * (d * h - e * g))


def distances2(first: Array, second: Array) -> Array:
    """Return the (n, m) squared distances between (n, 2) and (m, 2) points."""
    across = first[:, None, 0] - second[:, 0]
    down = first[:, None, 1] - second[:, 1]
    return np.asarray(across * across + down * down)

"""Numeric helpers for small arrays, called many times per frame. For a dozen numbers, the overhead of general functions
would exceed the computation."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array

Rows = NDArray[np.intp]


def median(values: Array) -> float:
    """Return the median of (n ≥ 1) finite numbers."""
    ordered = np.sort(values)
    n = len(ordered)
    return float(ordered[n // 2]) if n % 2 else 0.5 * (float(ordered[n // 2 - 1]) + float(ordered[n // 2]))


def standard_deviation(values: Array) -> float:
    """Return the standard deviation of (n ≥ 1) finite numbers: the root of their mean square difference from the mean."""
    off = values - values.sum() / len(values)
    return math.sqrt(float(off @ off) / len(values))


def quantile(values: Array, share: float) -> float:
    """Return the quantile of (n ≥ 1) finite numbers, interpolated between neighbours; ``share`` from 0 to 1."""
    ordered = np.sort(values)
    position = share * (len(ordered) - 1)
    k = min(int(position), max(len(ordered) - 2, 0))
    return float(ordered[k] + (position - k) * (ordered[min(k + 1, len(ordered) - 1)] - ordered[k]))


def close_pairs(col: Array | NDArray[np.integer], row: Array | NDArray[np.integer], reach: float) -> tuple[Rows, Rows]:
    """Return the pairs i < j of n points, ordered by i and then j, of which both coordinates differ by at most
    ``reach``. Points with NaN have no pair."""
    order = np.argsort(col, kind="stable")
    c, r = col[order], row[order]
    count = np.maximum(np.searchsorted(c, c + reach, side="right") - np.arange(len(c)) - 1, 0)
    first = np.repeat(np.arange(len(c)), count)
    second = first + 1 + np.arange(len(first)) - np.repeat(np.cumsum(count) - count, count)
    close = (np.abs(r[first] - r[second]) <= reach) & (c[second] - c[first] <= reach)
    one, other = order[first[close]], order[second[close]]
    one, other = np.minimum(one, other), np.maximum(one, other)
    in_order = np.lexsort((other, one))
    return one[in_order], other[in_order]


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

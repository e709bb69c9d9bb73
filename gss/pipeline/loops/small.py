"""Compiled order and median of hundreds of values."""

# The loops have no type annotations: numba compiles them for the argument types.
# mypy: allow-untyped-defs

from __future__ import annotations

import math

import numpy as np

from gss.pipeline.loops import loop


@loop
def middle_of(values, count):
    """Return the median of the first ``count`` values without changing their order; NaN if there are none."""
    return np.median(values[:count]) if count else math.nan


@loop
def ascending(values):
    """Return the order of the values, lowest first. Faster than ``np.argsort`` for hundreds of values that are spread over their
    range: they are counted into as many equal intervals as there are values, and then sorted by insertion."""
    n = len(values)
    order, bucket, start = np.empty(n, np.int64), np.empty(n, np.int64), np.zeros(n + 1, np.int64)
    if n == 0:
        return order
    low = values.min()
    scale = n / max(values.max() - low, 1e-300)
    for k in range(n):
        interval = np.int64((values[k] - low) * scale)
        bucket[k] = interval if 0 <= interval < n else (n - 1 if interval > 0 else 0)
        start[bucket[k] + 1] += 1
    for b in range(n):
        start[b + 1] += start[b]
    for k in range(n):
        order[start[bucket[k]]] = k
        start[bucket[k]] += 1
    for k in range(1, n):
        row, m = order[k], k
        while m > 0 and values[order[m - 1]] > values[row]:
            order[m] = order[m - 1]
            m -= 1
        order[m] = row
    return order

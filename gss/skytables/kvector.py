"""k-vector: index of an ascending table for range queries without a search (Mortari 1997, Huffman 2006 §6)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.errors import BadInput

Rows = NDArray[np.intp]
# Fraction of the range by which the line extends beyond both ends, so that rounding cannot place an end value beyond the
# line.
SLACK = 1e-9


@dataclass(frozen=True)
class KVector:
    """k-vector of an ascending table. ``k[t]`` is the number of values that do not exceed ``start`` + ``step``·t; ``k``
    is as long as the table. The values are distances in rad, or sin²θ in a
    :class:`~gss.skytables.sin2.Sin2Directory`."""

    k: NDArray[np.integer]
    start: float
    step: float

    def ranges(self, values: Array, low: Array, high: Array) -> tuple[Rows, Rows]:
        """Return, for each of (n,) closed intervals, the slice [from, to) of the ascending ``values`` in the interval.
        Each interval needs two look-ups and a comparison with a few neighbouring values."""
        first = self._count(values, low, strict=True)
        return first, np.maximum(first, self._count(values, high, strict=False))

    def _count(self, values: Array, limit: Array, *, strict: bool) -> Rows:
        """Count the values < limit (strict) or ≤ limit, by stepping from the line's cell to the exact position."""
        limit, n = np.atleast_1d(np.asarray(limit, float)), len(values)
        if not n:
            return np.zeros(len(limit), np.intp)
        cell = np.clip(np.floor((limit - self.start) / self.step), 0, n - 1).astype(np.intp)
        count = self.k[cell].astype(np.intp)
        while True:
            above, below = values[np.minimum(count, n - 1)], values[np.maximum(count - 1, 0)]
            forward = (count < n) & ((above < limit) if strict else (above <= limit))
            back = (count > 0) & ((below >= limit) if strict else (below > limit))
            if not (forward.any() or back.any()):
                return count
            count += forward.astype(np.intp) - back


def k_vector(values: NDArray[np.floating]) -> KVector:
    """Build the k-vector of ascending values. Raises BadInput if they are not ascending. The step is 1 if all values are equal."""
    v = np.asarray(values, float)
    if np.any(np.diff(v) < 0):
        raise BadInput("the table cannot be indexed by a k-vector", expected="ascending values")
    if not len(v) or not v[-1] > v[0]:
        return KVector(np.full(len(v), len(v), np.int32), float(v[0]) if len(v) else 0.0, 1.0)
    slack = SLACK * (v[-1] - v[0])
    step = (v[-1] - v[0] + 2 * slack) / (len(v) - 1)
    line = v[0] - slack + step * np.arange(len(v))
    k = np.searchsorted(v, line, side="right").astype(np.int32)
    k[0], k[-1] = 0, len(v)
    return KVector(k, float(v[0] - slack), float(step))

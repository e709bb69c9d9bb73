"""k-vector: index of an ascending table for range queries without a search (Mortari 1997, Huffman 2006 §6)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.errors import BadInput

Rows = NDArray[np.intp]
# The line extends this fraction of the range beyond both ends, so that rounding cannot put an end value outside it.
SLACK = 1e-9


@dataclass(frozen=True)
class KVector:
    """``k[t]`` is the number of values not above ``start`` + ``step``·t; ``k`` is as long as the table. The values are
    distances in rad or, in a directory by sine, sin²θ."""

    k: NDArray[np.integer]
    start: float
    step: float

    def ranges(self, values: Array, low: Array, high: Array) -> tuple[Rows, Rows]:
        """Return, for (n,) intervals, the slices [from, to) of the ascending ``values`` that contain exactly those inside
        them, both ends included. Each takes two look-ups and a comparison with a few neighbouring values."""
        first = self._count(values, low, strict=True)
        return first, np.maximum(first, self._count(values, high, strict=False))

    def _count(self, values: Array, limit: Array, *, strict: bool) -> Rows:
        """Count the values < limit (strict) or ≤ limit: start at the line's cell, then step to the exact place."""
        limit, n = np.atleast_1d(np.asarray(limit, float)), len(values)
        if not n:
            return np.zeros(len(limit), np.intp)
        cell = np.clip(np.floor((limit - self.start) / self.step), 0, n - 1).astype(np.intp)
        at = self.k[cell].astype(np.intp)
        while True:
            above, below = values[np.minimum(at, n - 1)], values[np.maximum(at - 1, 0)]
            forward = (at < n) & ((above < limit) if strict else (above <= limit))
            back = (at > 0) & ((below >= limit) if strict else (below > limit))
            if not (forward.any() or back.any()):
                return at
            at += forward.astype(np.intp) - back


def k_vector(values: NDArray[np.floating]) -> KVector:
    """Build the k-vector of ascending values; BadInput if they are not ascending. Without two different values the line
    has a step of 1."""
    v = np.asarray(values, float)
    if np.any(np.diff(v) < 0):
        raise BadInput("no k-vector of this table", expected="ascending values")
    if not len(v) or not v[-1] > v[0]:
        return KVector(np.full(len(v), len(v), np.int32), float(v[0]) if len(v) else 0.0, 1.0)
    slack = SLACK * (v[-1] - v[0])
    step = (v[-1] - v[0] + 2 * slack) / (len(v) - 1)
    line = v[0] - slack + step * np.arange(len(v))
    k = np.searchsorted(v, line, side="right").astype(np.int32)
    k[0], k[-1] = 0, len(v)
    return KVector(k, float(v[0] - slack), float(step))

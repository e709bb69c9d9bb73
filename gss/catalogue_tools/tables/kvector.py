"""k-vector: index of a sorted distance table for range queries in constant time (Huffman 2006 §6, Mortari 1997)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.errors import BadInput

# The line extends this fraction of the range beyond both ends, so that rounding cannot put an end value outside it.
SLACK = 1e-9


@dataclass(frozen=True)
class KVector:
    """``k[j]`` is the number of values not above ``slope_rad``·j + ``intercept_rad``; ``k`` is as long as the table."""

    k: NDArray[np.int32]
    slope_rad: float
    intercept_rad: float

    def bounds(self, low_rad: float, high_rad: float) -> tuple[int, int]:
        """Rows [start, end) of the table that contain every distance in [low, high], and at most one step more on
        each side."""
        last = len(self.k) - 1
        below = int(np.clip(np.floor((low_rad - self.intercept_rad) / self.slope_rad), 0, last))
        above = int(np.clip(np.ceil((high_rad - self.intercept_rad) / self.slope_rad), 0, last))
        if high_rad < self.intercept_rad or low_rad > self.intercept_rad + self.slope_rad * last:
            return 0, 0
        return int(self.k[below]), int(self.k[above])


def k_vector(distance_rad: Array) -> KVector:
    """Build the k-vector of an ascending table with at least two different distances; BadInput otherwise."""
    d = np.asarray(distance_rad, float)
    if len(d) < 2 or not d[-1] > d[0] or np.any(np.diff(d) < 0):
        raise BadInput("no k-vector of this table", expected="ascending distances, at least two different ones")
    slack = SLACK * (d[-1] - d[0])
    slope = (d[-1] - d[0] + 2 * slack) / (len(d) - 1)
    line = d[0] - slack + slope * np.arange(len(d))
    k = np.searchsorted(d, line, side="right").astype(np.int32)
    k[0], k[-1] = 0, len(d)
    return KVector(k, float(slope), float(d[0] - slack))

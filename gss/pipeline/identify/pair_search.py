"""Search over pairs of detections, in order of brightness, for hypotheses that third stars support.

All third stars of a pair are examined together. ``gss.pipeline.loops.search`` computes the same trials with compiled
loops.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.pipeline.identify.verify import FrameDetections, SkyCatalogue
from gss.skytables.pairs import DistanceTable

TOLERANCE_SIGMA = 3.5
MAX_HYPOTHESES = 500_000
MAX_OF_A_PAIR = 50_000  # hypotheses; a pair with more identifies no star
COLLINEAR = 4.0
MAX_CANDIDATES = 3


def limits(budget: int) -> tuple[int, int, float, int]:
    """Return the limits of a search in the order that the compiled search expects."""
    return MAX_OF_A_PAIR, budget, COLLINEAR, MAX_CANDIDATES


class Trial(NamedTuple):
    """Hypothesis: three rows of the list of detections, and their stars."""

    rows: tuple[int, int, int]
    stars: tuple[int, int, int]


def _pair_order(n: int, groups: int) -> Iterator[tuple[int, int]]:
    """Yield pairs (i, j), i < j, of the same group, bright pairs first, in an order that spreads the pairs of a single
    (possibly false) star."""
    for total in range(1, 2 * n - 2):
        for i in range(max(0, total - n + 1), (total + 1) // 2):
            if (total - 2 * i) % groups == 0:
                yield i, total - i


def _cross(a: Array, b: Array) -> Array:
    """Return the (3, …) cross product. For a dozen vectors, the overhead of numpy's function exceeds the
    computation."""
    return np.stack([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])


class PairSearch:
    """Candidate lists of one field, built once per anchor star and joined once per pair."""

    def __init__(
        self,
        field: FrameDetections,
        sky: SkyCatalogue,
        table: DistanceTable,
        n: int,
        scale_error: float,
        need: int,
        groups: int,
        budget: int,
    ) -> None:
        self.sky, self.table, self.n = sky, table, n
        self.need, self.groups, self.budget = need, groups, budget
        self.unit = field.unit[:n]
        chord = np.linalg.norm(self.unit[:, None] - self.unit[None], axis=-1)
        self.distance = 2 * np.arcsin(np.minimum(1.0, chord / 2))
        s2 = field.sigma_rad[:n] ** 2
        self.tolerance = TOLERANCE_SIGMA * np.sqrt(s2[:, None] + s2) + scale_error * self.distance
        low, high = np.maximum(self.distance - self.tolerance, 0), self.distance + self.tolerance
        start, stop = table.ranges(low.ravel(), high.ravel())
        self.start, self.stop = start.reshape(n, n), stop.reshape(n, n)
        cos_low, cos_high = np.cos(high), np.cos(low)
        self.cos_middle, self.cos_half = (cos_low + cos_high) / 2, (cos_high - cos_low) / 2
        self.xyz = np.ascontiguousarray(sky.icrs.T)
        self.anchors: dict[int, tuple[NDArray[np.intp], NDArray[np.int32], NDArray[np.int32]]] = {}
        self.hypotheses = 0
        self.is_too_long = False

    def _anchor(self, i: int) -> tuple[NDArray[np.intp], NDArray[np.int32], NDArray[np.int32]]:
        """Return all candidates of the pairs with star i as (offsets, other star, partner), grouped by the catalogue star of i."""
        if i not in self.anchors:
            lists = [(k, slice(self.start[i, k], self.stop[i, k])) for k in range(self.n) if k != i]
            first = np.concatenate([self.table.first[s] for _, s in lists])
            second = np.concatenate([self.table.second[s] for _, s in lists])
            k = np.repeat([k for k, _ in lists], [s.stop - s.start for _, s in lists]).astype(np.int64)
            me = np.concatenate([first, second]).astype(np.int64)
            other = np.concatenate([second, first]).astype(np.int64)
            # One sort of packed 64-bit words is several times faster than an argsort and three gathers.
            packed = np.sort(me << 40 | np.concatenate([k, k]) << 32 | other)
            offsets = np.concatenate([[0], np.cumsum(np.bincount(me, minlength=len(self.sky)))])
            self.anchors[i] = (offsets, (packed >> 32 & 0xFF).astype(np.int32), (packed & 0xFFFFFFFF).astype(np.int32))
        return self.anchors[i]

    def run(self) -> Iterator[Trial]:
        """Yield the trials of each pair, best supported first, until the budget is used up."""
        for i, j in _pair_order(self.n, self.groups):
            if self.hypotheses > self.budget:
                self.is_too_long = True
                return
            for first, second, third, its in self._candidates(i, j):
                yield Trial((i, j, third), (first, second, its))

    def _candidates(self, i: int, j: int) -> list[tuple[int, int, int, int]]:
        """Return the hypotheses (star of i, star of j, third row, star of the third) that at least one more star
        supports, best supported first."""
        s = slice(self.start[i, j], self.stop[i, j])
        a = np.concatenate([self.table.first[s], self.table.second[s]])
        b = np.concatenate([self.table.second[s], self.table.first[s]])
        self.hypotheses += len(a)
        if not 0 < len(a) <= MAX_OF_A_PAIR:
            return []
        offsets, anchor_k, anchor_c = self._anchor(i)
        count = offsets[a + 1] - offsets[a]
        h = np.repeat(np.arange(len(a)), count)
        pos = np.arange(len(h)) + (offsets[a] - (np.cumsum(count) - count))[h]
        k, c = anchor_k.take(pos), anchor_c.take(pos)
        off = -self.cos_middle[j].take(k)
        for axis in self.xyz:  # one coordinate at a time, because indexing complete vectors is several times slower
            off += axis[b].take(h) * axis.take(c)
        fits = np.flatnonzero(np.abs(off) <= self.cos_half[j].take(k))
        h, k, c = h[fits], k[fits], c[fits]
        fits = np.flatnonzero((k != j) & (c != b[h]))
        return self._supported(i, j, a, b, h[fits], k[fits], c[fits])

    def _supported(
        self,
        i: int,
        j: int,
        a: NDArray[np.int32],
        b: NDArray[np.int32],
        h: NDArray[np.intp],
        k: NDArray[np.int32],
        c: NDArray[np.int32],
    ) -> list[tuple[int, int, int, int]]:
        if not len(h):
            return []
        u, icrs = self.unit, self.sky.icrs
        handedness = u[k] @ _cross(u[i], u[j])
        triple_product = (_cross(icrs[a[h]].T, icrs[b[h]].T) * icrs[c].T).sum(0)
        # Nearly collinear triangles have no reliable handedness; they are tested later on the whole field.
        flat = (
            COLLINEAR
            * self.tolerance[i, j]
            * np.maximum(self.distance[i, j], np.maximum(self.distance[i, k], self.distance[j, k]))
        )
        right = (handedness * triple_product > 0) | (np.maximum(np.abs(handedness), np.abs(triple_product)) < flat)
        h, k, c, handedness = h[right], k[right], c[right], handedness[right]
        if not len(h):
            return []
        detections = np.unique(h * self.n + k) // self.n  # a detection supports a pair once, whatever stars it can be
        votes = np.bincount(detections, minlength=len(a))
        out = []
        strong = np.flatnonzero(votes >= self.need)
        for index in strong[np.argsort(-votes[strong], kind="stable")][:MAX_CANDIDATES]:
            members = np.flatnonzero(h == index)
            widest = members[np.argmax(np.abs(handedness[members]))]
            out.append((int(a[index]), int(b[index]), int(k[widest]), int(c[widest])))
        return out

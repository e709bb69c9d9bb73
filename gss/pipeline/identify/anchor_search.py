"""Search for the stars of a field: each detection in turn is the anchor, and each star that it can be is tested together with
all stars that the later detections can then be.

The detections are sorted by brightness. The search begins with groups of few detections, bright ones first, and repeats
with groups of twice as many, up to all detections: the time of a group grows faster than its size, and one group in
which most detections are stars is enough. ``gss.pipeline.loops.search`` computes the same candidates with compiled loops.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array, cross
from gss.pipeline.identify.verify import FrameDetections, SkyCatalogue
from gss.pipeline.small import Rows
from gss.skytables.pairs import DistanceTable

TOLERANCE_SIGMA = 4.0
"""Tolerance of the distances between the detections of a candidate, in standard deviations."""
MAX_HYPOTHESES = 5_000_000
MAX_OF_A_PAIR = 50_000  # hypotheses; a pair with more identifies no star
COLLINEAR = 4.0
MAX_CANDIDATES = 64
SMALLEST_GROUP = 6  # detections
PAIRS_AT_ONCE = 200_000
"""Pairs of entries that are compared at once; limits the memory."""


def limits(budget: int) -> tuple[int, int, float, int]:
    """Return the limits of a search in the order that the compiled search expects."""
    return MAX_OF_A_PAIR, budget, COLLINEAR, MAX_CANDIDATES


def groups(detections: int, only_first: bool) -> Iterator[tuple[int, int]]:
    """Yield the first and last + 1 detection of each group that is searched; the last group has all detections.
    ``only_first``: only the brightest group of each size."""
    size = min(SMALLEST_GROUP, detections)
    while True:
        for first in range(0, size if only_first else detections, size):
            yield first, min(first + size, detections)
        if size == detections:
            return
        size = next_size(size, detections)


def next_size(size: int, detections: int) -> int:
    """Return the size of the groups after those of ``size``: twice as many, or all detections if these are hardly more."""
    return 2 * size if 3 * size <= detections else detections


class Trial(NamedTuple):
    """Candidate: three rows of the list of detections, and their stars.

    ``rank``: number of hypotheses of the earlier groups of the same size, and of the pairs of this group whose sum of rows
    is at most that of the first two. It is used as the number of tried hypotheses in the false-match probability, so bright
    stars need less evidence than faint ones. The sum of 1/rank over the hypotheses of all groups of one size, about 9, is
    the factor by which their search accepts more accidental matches than one hypothesis.
    """

    rows: tuple[int, int, int]
    stars: tuple[int, int, int]
    rank: int


class _Entries(NamedTuple):
    """Hypotheses of an anchor: star of the anchor, other detection and its star. Sorted by the star of the anchor and the
    detection."""

    anchor_star: NDArray[np.int64]
    detection: NDArray[np.int64]
    star: NDArray[np.int64]


def _triple(v: Array, a: NDArray[np.integer] | int, b: NDArray[np.integer], c: NDArray[np.integer]) -> Array:
    return np.asarray(np.einsum("...i,...i->...", v[a], cross(v[b], v[c])))


class AnchorSearch:
    """Search over the ``n`` brightest detections of a field. ``only_first``: see :func:`groups`. ``hypotheses``: number of
    examined pairs of stars for pairs of detections; a pair is counted in each of its groups. ``is_too_long``: True if the
    budget is used up."""

    def __init__(
        self,
        field: FrameDetections,
        sky: SkyCatalogue,
        table: DistanceTable,
        n: int,
        scale_error: float,
        need: int,
        budget: int,
        only_first: bool = False,
    ) -> None:
        self.sky, self.table, self.n, self.need, self.budget = sky, table, n, need, budget
        self.only_first = only_first
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
        of_pair = 2 * (self.stop - self.start)
        self.hypotheses_of = np.triu(np.where(of_pair <= MAX_OF_A_PAIR, of_pair, 0), 1)
        self.hypotheses = 0
        self.is_too_long = False

    def run(self) -> Iterator[Trial]:
        """Yield the candidates of each anchor, those with most votes first, until the budget is used up."""
        before = 0
        for first, stop in groups(self.n, self.only_first):
            before = before if first else 0
            row = np.arange(stop - first)
            row_sum = np.add.outer(row, row)
            of_pair = self.hypotheses_of[first:stop, first:stop]
            ranks = before + np.cumsum(np.bincount(row_sum.ravel(), of_pair.ravel()))
            for i in range(first, stop - self.need - 1):
                if self.hypotheses > self.budget:
                    self.is_too_long = True
                    return
                self.hypotheses += int(of_pair[i - first].sum())
                for a, k, c, third, third_star in self._candidates(i, self._entries(i, stop)):
                    yield Trial((i, k, third), (a, c, third_star), int(ranks[i + k - 2 * first]))
            before = int(ranks[-1])

    def _entries(self, i: int, stop: int) -> _Entries:
        others = [k for k in range(i + 1, stop) if self.hypotheses_of[i, k]]
        slices = [slice(self.start[i, k], self.stop[i, k]) for k in others]
        ends = [np.stack([self.table.first[s], self.table.second[s]], axis=1) for s in slices]
        both = np.concatenate([np.empty((0, 2), np.int64), *ends])
        anchor_star, star = both.ravel(), both[:, ::-1].ravel()
        detection = np.repeat(others, [2 * len(e) for e in ends]).astype(np.int64)
        order = np.argsort(anchor_star, kind="stable")
        order = order[np.bincount(anchor_star)[anchor_star[order]] > self.need] if len(order) else order
        return _Entries(anchor_star[order], detection[order], star[order])

    def _candidates(self, i: int, entries: _Entries) -> list[tuple[int, int, int, int, int]]:
        """Return the candidates of anchor i: star of i, detection, its star, third detection, its star. An entry has a
        vote for every other detection of which an entry of the same star fits its distance and handedness."""
        anchor_star, detection, star = entries
        if not len(star):
            return []
        e, f, triple = self._fitting(i, entries)
        both, other = np.concatenate([e, f]), np.concatenate([f, e])
        # A detection votes once, whatever stars it can be.
        voters = np.unique(both * self.n + detection[other]) // self.n
        votes = np.bincount(voters, minlength=len(star))
        width = np.abs(np.concatenate([triple, triple]))
        out = []
        strong = np.flatnonzero(votes >= self.need)
        for best in strong[np.argsort(-votes[strong], kind="stable")][:MAX_CANDIDATES]:
            fitting = np.flatnonzero(both == best)
            fitting = fitting[np.argsort(other[fitting])]
            widest = other[fitting[np.argmax(width[fitting])]]
            first = int(anchor_star[best]), int(detection[best]), int(star[best])
            out.append((*first, int(detection[widest]), int(star[widest])))
        return out

    def _fitting(self, i: int, entries: _Entries) -> tuple[Rows, Rows, Array]:
        """Return the pairs of entries of one star whose distance and handedness fit, and the triple products of the
        detections."""
        anchor_star, _, star = entries
        after = np.searchsorted(anchor_star, anchor_star, side="right") - 1 - np.arange(len(star))
        block = np.cumsum(after) // PAIRS_AT_ONCE
        first = np.flatnonzero(np.diff(block, prepend=-1))
        parts = [
            self._fitting_part(i, entries, np.arange(start, stop), after[start:stop])
            for start, stop in pairwise([*first.tolist(), len(star)])
        ]
        e, f, measured = (np.concatenate(columns) for columns in zip(*parts, strict=True))
        return e, f, measured

    def _fitting_part(self, i: int, entries: _Entries, entry: Rows, after: Rows) -> tuple[Rows, Rows, Array]:
        """Return the pairs of :meth:`_fitting` whose first entry is one of ``entry``. ``after``: number of the following
        entries of the same star."""
        anchor_star, detection, star = entries
        e = np.repeat(entry, after)
        f = e + 1 + np.arange(len(e)) - np.repeat(np.cumsum(after) - after, after)
        k, m = detection[e], detection[f]
        icrs = self.sky.icrs[star]
        off = sum(icrs[e, axis] * icrs[f, axis] for axis in range(3)) - self.cos_middle[k, m]
        fits = (np.abs(off) <= self.cos_half[k, m]) & (k != m) & (star[e] != star[f])
        e, f, k, m = e[fits], f[fits], k[fits], m[fits]
        measured = _triple(self.unit, i, k, m)
        listed = _triple(self.sky.icrs, anchor_star[e], star[e], star[f])
        # Nearly collinear triangles have no reliable handedness; they are tested later on the whole field.
        longest = np.maximum(np.maximum(self.distance[i, k], self.distance[i, m]), self.distance[k, m])
        flat = COLLINEAR * np.maximum(self.tolerance[i, k], self.tolerance[i, m]) * longest
        right = (measured * listed > 0) | (np.maximum(np.abs(measured), np.abs(listed)) < flat)
        return e[right], f[right], measured[right]

"""Candidate matrix of the n-vertex match: the candidates of every baseline from the directory (Huffman 2006 §5.5.4,
matrix C).

A baseline is a pair of imaged stars. Its candidates are stored in both directions, p → q and q → p, sorted by p, then
q. They correspond to a column of the document's matrix S, and a star can have several partners.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from gss.domain.angles import Array
from gss.pipeline.kernels import kernels
from gss.skytables.kvector import Rows
from gss.skytables.sin2 import Sin2Directory, sin2_interval, sin2_of


@dataclass(frozen=True)
class BaselineCandidates:
    """Directed candidates of one baseline: ``key`` = p·stars + q, ascending, for star p and partner q. The partners of p are a
    slice of the keys, found by binary search."""

    key: Rows
    stars: int

    @cached_property
    def pairs(self) -> Rows:
        """(m, 2) candidates p, q."""
        return np.stack(np.divmod(self.key, self.stars), axis=1)

    def partners(self, of: Rows) -> tuple[Rows, Rows]:
        """Return all partners of the (n,) stars ``of``, and for each partner the index of its star in ``of``."""
        first_key = of * self.stars
        low, high = self.key.searchsorted(first_key), self.key.searchsorted(first_key + self.stars)
        some = np.flatnonzero(high > low)
        count = high[some] - low[some]
        end = count.cumsum()
        entry = np.arange(end[-1] if len(end) else 0) + (low[some] - end + count).repeat(count)
        return some.repeat(count), self.pairs[entry, 1]

    def holds(self, p: Rows, q: Rows) -> np.ndarray:
        """True for each of n pairs that is a candidate."""
        if not len(self.key):
            return np.zeros(len(p), bool)
        keys = p * self.stars + q
        position = np.minimum(self.key.searchsorted(keys), len(self.key) - 1)
        return np.asarray(self.key[position] == keys)


def extended(names: Rows, columns: tuple[BaselineCandidates, ...]) -> Rows:
    """Return the (m, k + 1) sets that add one star to (n, k) sets of catalogue rows. ``columns``: the k baselines from the
    stars of the set to the star that is added."""
    index, partner = columns[0].partners(names[:, 0])
    for other, column in enumerate(columns[1:], 1):
        good = column.holds(names[index, other], partner)
        index, partner = index[good], partner[good]
    return np.concatenate([names[index], partner[:, None]], axis=1)


@dataclass
class Baselines:
    """All baselines of n imaged stars. A column is computed at its first use. ``hits``: number of directory entries
    read up to now. ``low``, ``high``: (n, n) bounds of the slices of the directory. ``extend``: see :func:`extended`."""

    directory: Sin2Directory
    low: Rows
    high: Rows
    extend: Callable[[Rows, tuple[BaselineCandidates, ...]], Rows] = extended
    hits: int = 0
    _columns: dict[tuple[int, int], BaselineCandidates] = field(default_factory=dict, repr=False)

    def column(self, i: int, j: int) -> BaselineCandidates:
        """Return the candidates of baseline (i, j). They are equal to those of (j, i)."""
        key = (i, j) if i < j else (j, i)
        if key not in self._columns:
            low, high = int(self.low[key]), int(self.high[key])
            first, second = self.directory.first[low:high], self.directory.second[low:high]
            n = max(self.directory.stars, 1)
            self._columns[key] = BaselineCandidates(
                np.sort(np.concatenate([first * n + second, second * n + first])), n
            )
            self.hits += high - low
        return self._columns[key]


def baselines(unit_cam: Array, tolerance_rad: Array, directory: Sin2Directory, fast: bool | None = None) -> Baselines:
    """Build the baselines of (n, 3) measured directions; ``tolerance_rad``: (n, n) tolerance of the angle of each pair;
    ``fast``: see ``kernels.kernels``."""
    loops = kernels(fast).lists
    n = len(unit_cam)
    i, j = np.triu_indices(n, 1)
    low, high = np.zeros((n, n), np.intp), np.zeros((n, n), np.intp)
    if len(i):
        interval = sin2_interval(sin2_of(unit_cam[i], unit_cam[j]), tolerance_rad[i, j])
        low[i, j], high[i, j] = directory.ranges(*interval)
    return Baselines(directory, low, high, extended if loops is None else loops.extended)

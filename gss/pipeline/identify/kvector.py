"""Pairs of catalogue stars by angular distance, with search-free range look-up: the k-vector (Mortari & Neta 2000)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gss.domain.angles import Array
from gss.domain.errors import BadInput


@dataclass(frozen=True)
class PairTable:
    """Pairs ``first``, ``second`` (rows of the star list) with ascending ``distance_rad``, and the k-vector over them.

    ``below[k]`` counts the distances ≤ ``start_rad + k·step_rad``, so any range takes two look-ups and a short correction.
    """

    first: NDArray[np.int32]
    second: NDArray[np.int32]
    distance_rad: Array
    below: NDArray[np.intp]
    start_rad: float
    step_rad: float

    def __len__(self) -> int:
        return len(self.distance_rad)

    def ranges(self, low_rad: Array, high_rad: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return, for each of n intervals, the slice [from, to) of the table that contains exactly the distances inside it."""
        return self._count(low_rad, strict=True), self._count(high_rad, strict=False)

    def _count(self, value_rad: Array, *, strict: bool) -> NDArray[np.intp]:
        """Count the distances < value (strict) or ≤ value."""
        value = np.atleast_1d(np.asarray(value_rad, float))
        k = np.clip(np.floor((value - self.start_rad) / self.step_rad), 0, len(self.below) - 1).astype(np.intp)
        at = self.below[k].copy()
        n = len(self.distance_rad)
        if not n:
            return np.zeros(len(value), np.intp)
        # A bin contains about one distance, so these loops end after a step or two.
        while True:
            d = self.distance_rad[np.minimum(at, n - 1)]
            up = (at < n) & ((d < value) if strict else (d <= value))
            if not up.any():
                break
            at[up] += 1
        while True:
            d = self.distance_rad[np.maximum(at - 1, 0)]
            down = (at > 0) & ((d >= value) if strict else (d > value))
            if not down.any():
                return at
            at[down] -= 1


def pair_table(icrs: Array, min_rad: float, max_rad: float) -> PairTable:
    """Build the table of all pairs of (n, 3) unit vectors whose distance lies in [min_rad, max_rad]."""
    if not 0 <= min_rad < max_rad <= np.pi:
        raise BadInput(
            "pair distances are impossible", expected="0 ≤ min < max ≤ π", got=f"{min_rad:g}, {max_rad:g} rad"
        )
    first, second = _close_pairs(icrs, max_rad)
    chord = np.linalg.norm(icrs[first] - icrs[second], axis=1)
    distance = 2 * np.arcsin(np.minimum(1.0, chord / 2))
    keep = np.flatnonzero((distance >= min_rad) & (distance <= max_rad))
    keep = keep[np.argsort(distance[keep], kind="stable")]
    distance = distance[keep]
    n = len(distance)
    step = float(distance[-1] - distance[0]) / max(n - 1, 1) if n else 1.0
    step = step if step > 0 else 1.0
    start = float(distance[0]) if n else 0.0
    line = start + step * np.arange(max(n, 1))
    below = np.searchsorted(distance, line, side="right")
    return PairTable(first[keep], second[keep], distance, below, start, step)


def _close_pairs(icrs: Array, max_rad: float) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Row indices, first < second, of pairs within ``max_rad``."""
    n = len(icrs)
    if n <= 1500:
        cosine = icrs @ icrs.T
        first, second = np.nonzero(np.triu(cosine >= np.cos(max_rad) - 1e-12, 1))
    else:
        chord = 2 * np.sin(max_rad / 2) * (1 + 1e-12)
        pairs = cKDTree(icrs).query_pairs(chord, output_type="ndarray")
        first, second = pairs[:, 0], pairs[:, 1]
    return first.astype(np.int32), second.astype(np.int32)

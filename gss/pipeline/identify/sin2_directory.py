"""Pairs of catalogue stars by sin²θ, with a k-vector for search-free range look-up (Huffman 2006 §5.5.4).

sin²θ needs no arccosine on board, is twice as sensitive as cos θ at small angles (eq. 6.6) and increases nearly linearly
over the sorted table, as the k-vector's straight line requires. It is monotonic up to 90° only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.domain.stars import DistanceTable

Rows = NDArray[np.intp]


@dataclass(frozen=True)
class Sin2Directory:
    """``first``, ``second``: (m,) rows of the star list, ``sin2`` ascending. ``k[t]`` counts the values ≤
    ``line_start + line_step·t``, t = 0 … m − 1."""

    first: Rows
    second: Rows
    sin2: Array
    k: Rows
    line_start: float
    line_step: float
    stars: int

    def __len__(self) -> int:
        return len(self.sin2)

    def ranges(self, low: Array, high: Array) -> tuple[Rows, Rows]:
        """Return, for (n,) intervals, the slices [from, to) of the table that contain exactly the values inside them, both ends
        included. Each takes two look-ups and a comparison with a few neighbouring values."""
        if not len(self):
            none = np.zeros(len(np.atleast_1d(low)), np.intp)
            return none, none
        low, high = np.atleast_1d(np.asarray(low, float)), np.atleast_1d(np.asarray(high, float))
        start = self._trim(self.k[self._cell(low)], low, strict=True)
        return start, np.maximum(start, self._trim(self.k[self._cell(high)], high, strict=False))

    def restricted(self, allowed: NDArray[np.bool_]) -> Sin2Directory:
        """Return the pairs whose two stars are both in the (stars,) mask ``allowed``."""
        keep = np.flatnonzero(allowed[self.first] & allowed[self.second])
        return indexed(self.first[keep], self.second[keep], self.sin2[keep], self.stars)

    def _cell(self, value: Array) -> Rows:
        t = np.floor((value - self.line_start) / self.line_step)
        return np.clip(t, 0, len(self) - 1).astype(np.intp)

    def _trim(self, at: Rows, value: Array, *, strict: bool) -> Rows:
        """Move (n,) positions to the count of values < ``value`` (strict) or ≤ ``value``."""
        at, n = at.copy(), len(self)
        while True:
            met = self.sin2[np.minimum(at, n - 1)]
            forward = (at < n) & ((met < value) if strict else (met <= value))
            met = self.sin2[np.maximum(at - 1, 0)]
            back = (at > 0) & ((met >= value) if strict else (met > value))
            if not (forward.any() or back.any()):
                return at
            at += forward.astype(np.intp) - back


def sin2_directory(table: DistanceTable, stars: int) -> Sin2Directory:
    """Build the directory of a distance table over a list of ``stars`` rows, in the table's order."""
    if len(table) and float(table.distance_rad[-1]) > np.pi / 2:
        raise BadInput(
            "sin²θ does not tell pairs beyond 90° apart",
            expected="a largest distance of at most 90°",
            got=f"{np.degrees(float(table.distance_rad[-1])):.1f}°",
        )
    sine = np.sin(table.distance_rad.astype(float))
    return indexed(table.first.astype(np.intp), table.second.astype(np.intp), sine * sine, stars)


def indexed(first: Rows, second: Rows, sin2: Array, stars: int) -> Sin2Directory:
    """Build a directory of ascending values with its k-vector."""
    n = len(sin2)
    span = float(sin2[-1] - sin2[0]) if n else 0.0
    step = span / (n - 1) if n > 1 and span > 0 else 1.0
    start = float(sin2[0]) if n else 0.0
    k = np.searchsorted(sin2, start + step * np.arange(n), side="right").astype(np.intp)
    return Sin2Directory(first, second, sin2, k, start, step, stars)


def sin2_of(unit_a: Array, unit_b: Array) -> Array:
    """(n,) sin² of the angles between (n, 3) unit vectors, from the cross product, which keeps full precision."""
    across = np.cross(unit_a, unit_b)
    return np.asarray(np.einsum("ij,ij->i", across, across))


def sin2_interval(sin2: Array, tolerance_rad: Array) -> tuple[Array, Array]:
    """(n,) ends of the sin² intervals for angles within ``tolerance_rad`` (n,) of the measured ones, below 90°."""
    angle = np.arcsin(np.sqrt(np.clip(sin2, 0.0, 1.0)))
    low = np.sin(np.maximum(angle - tolerance_rad, 0.0))
    high = np.sin(np.minimum(angle + tolerance_rad, np.pi / 2))
    return low * low, high * high

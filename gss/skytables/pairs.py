"""Pairs of stars that one frame can show together, sorted by distance (Jacobs 1995 app. D.1, Erlank 2013 alg. 1)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.domain.stars import StarTable


@dataclass(frozen=True)
class DistanceTable:
    """Pairs of stars sorted by angular distance.

    ``first`` < ``second`` are row numbers of the associated star list; ``distance_rad`` is ascending. A table read from
    a device has float32 distances, so that a replay uses the same values as the device.
    """

    first: NDArray[np.int32]
    second: NDArray[np.int32]
    distance_rad: NDArray[np.floating]
    min_rad: float
    max_rad: float

    def __len__(self) -> int:
        return len(self.distance_rad)

    def single_precision(self) -> DistanceTable:
        """Return the table with distances in float32, as a device stores them."""
        return replace(self, distance_rad=self.distance_rad.astype(np.float32))

    def ranges(self, low_rad: Array, high_rad: Array) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
        """Return for each of n intervals the slice [from, to) of the pairs with a distance inside it, both ends included."""
        return (
            np.searchsorted(self.distance_rad, low_rad, side="left"),
            np.searchsorted(self.distance_rad, high_rad, side="right"),
        )


def expanded(low: NDArray[np.intp], high: NDArray[np.intp]) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Expand (m,) slices [low, high) of a table. Returns one pair (slice number, table row) per row."""
    count = np.maximum(high - low, 0)
    slice_number = np.repeat(np.arange(len(count)), count)
    return slice_number, np.arange(len(slice_number)) - np.repeat(np.cumsum(count) - count, count) + np.repeat(
        low, count
    )


def distance_table(stars: StarTable, min_rad: float, max_rad: float) -> DistanceTable:
    """Build the table of all pairs of ``stars`` with ``min_rad`` ≤ distance ≤ ``max_rad``, in ascending order of distance."""
    return distance_table_of_units(stars.icrs, min_rad, max_rad)


def distance_table_of_units(unit: NDArray[np.floating], min_rad: float, max_rad: float) -> DistanceTable:
    """Build the pair table of (n, 3) unit vectors.

    Distances are computed from chords: the arccosine of Jacobs eq. C.7 and Erlank eq. 4.3.1 loses 1e-8 rad for close
    stars. Equal distances are ordered by row number, so the table is the same on any machine.
    """
    _check_limits(min_rad, max_rad)
    u = np.ascontiguousarray(unit, float)
    u = u / np.linalg.norm(u, axis=1, keepdims=True)
    first, second = _pairs_within(u, 2 * np.sin(max_rad / 2))
    half_chord = 0.5 * _chord(u, first, second)
    distance = 2 * np.arcsin(np.minimum(half_chord, 1.0))
    keep = np.flatnonzero((distance >= min_rad) & (distance <= max_rad))
    keep = keep[np.lexsort((second[keep], first[keep], distance[keep]))]
    return DistanceTable(first[keep], second[keep], distance[keep], float(min_rad), float(max_rad))


def _check_limits(min_rad: float, max_rad: float) -> None:
    if not 0 <= min_rad < max_rad <= np.pi:
        raise BadInput(
            "invalid distance limits",
            expected="0 ≤ smallest < largest ≤ 180°",
            got=f"{np.degrees(min_rad):g}° to {np.degrees(max_rad):g}°",
        )


def _pairs_within(unit: Array, chord: float) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Return the row pairs (first < second) with a chord of at most ``chord`` plus a rounding margin."""
    if len(unit) < 2:
        empty = np.empty(0, np.int32)
        return empty, empty
    pairs = cKDTree(unit).query_pairs(chord * (1 + 1e-9), output_type="ndarray")
    return pairs[:, 0].astype(np.int32), pairs[:, 1].astype(np.int32)


def _chord(unit: Array, first: NDArray[np.int32], second: NDArray[np.int32]) -> Array:
    """Return the chord lengths. The axes are processed one at a time, which needs a third of the memory traffic of
    gathering rows."""
    squared = np.zeros(len(first))
    for axis in unit.T:
        step = axis[first] - axis[second]
        squared += step * step
    return np.asarray(np.sqrt(squared))

"""Identification of three stars by their distances. Each of a few reference stars has several candidates (Jacobs 1995 §4.1.4)."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array

Rows = NDArray[np.intp]
# When the seventh reference star is added, the first four are dropped (§4.1.4.1).
MAX_GROUPS, GIVEN_UP = 7, 4
STARS, PAIR = 3, 2


@dataclass(frozen=True)
class Candidates:
    """A reference star and the observed stars that may match it: a column of the document's Tables 4-1 and 4-2."""

    reference: int
    observed: Rows


@dataclass
class ThreeStars:
    """Search for three stars with the right distances. Columns are added one by one, and all sets of three with the new
    column are tested.

    ``unit_cam`` (n, 3) observed and ``reference_unit`` (m, 3) unit vectors. ``result``: (observed, reference) of the
    three stars, ``pair``: the first two that fit, used if no three do. ``operations``: number of distances compared.
    """

    unit_cam: Array
    reference_unit: Array
    tolerance_rad: float
    columns: list[Candidates] = field(default_factory=list)
    result: list[tuple[int, int]] = field(default_factory=list)
    pair: list[tuple[int, int]] = field(default_factory=list)
    operations: int = 0

    def add(self, new: Candidates) -> bool:
        """Add a column and return True if three stars have been found."""
        if self.result or not len(new.observed):
            return bool(self.result)
        if len(self.columns) + 1 == MAX_GROUPS:
            del self.columns[:GIVEN_UP]
        if not self.pair:
            for old in self.columns:
                self.pair = self.pair or self._fit((old, new))
        for first, second in itertools.combinations(self.columns, STARS - 1):
            self.result = self._fit((first, second, new))
            if self.result:
                break
        self.columns.append(new)
        return bool(self.result)

    def _fit(self, columns: tuple[Candidates, ...]) -> list[tuple[int, int]]:
        """Return the first choice of one candidate per column for which all distances fit, by depth-first search."""

        def grow(chosen: list[tuple[int, int]]) -> list[tuple[int, int]]:
            if len(chosen) == len(columns):
                return chosen
            column = columns[len(chosen)]
            for k in column.observed.tolist():
                if all(self._same_distance(pair, (k, column.reference)) for pair in chosen):
                    grown = grow([*chosen, (k, column.reference)])
                    if grown:
                        return grown
            return []

        return grow([])

    def _same_distance(self, match: tuple[int, int], other: tuple[int, int]) -> bool:
        if match[0] == other[0]:
            return False
        self.operations += 1
        angle_rad = _angle_rad(self.unit_cam[match[0]], self.unit_cam[other[0]])
        reference_rad = _angle_rad(self.reference_unit[match[1]], self.reference_unit[other[1]])
        return abs(angle_rad - reference_rad) <= self.tolerance_rad


def _angle_rad(a: Array, b: Array) -> float:
    return float(2 * np.arcsin(min(1.0, 0.5 * float(np.linalg.norm(a - b)))))


def by_boxes(pixels: Array, columns: int, rows: int) -> Rows:
    """Return the order in which (n, 2) expected stars are searched: the first star of each of nine boxes, then the
    second of each, and so on (Fig. 4-4, 4-5). Boxes are numbered along the rows; the order within a box does not
    change."""
    col = np.clip(np.floor((pixels[:, 0] + 0.5) * 3 / columns), 0, 2).astype(np.intp)
    row = np.clip(np.floor((pixels[:, 1] + 0.5) * 3 / rows), 0, 2).astype(np.intp)
    box = 3 * row + col
    turn = np.zeros(len(box), np.intp)
    for b in range(9):
        inside = np.flatnonzero(box == b)
        turn[inside] = np.arange(len(inside))
    return np.lexsort((box, turn))

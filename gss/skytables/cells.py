"""Stars grouped by cells of the sky, to list the stars near a direction without a search through all of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gss.domain.angles import Array

GOLDEN_RAD = np.pi * (3 - 5**0.5)
STARS_PER_CELL, MOST_CELLS = 12, 800


@dataclass(frozen=True)
class SkyCells:
    """m cells. ``middle``: (m, 3) directions; ``cos_extent``, ``sin_extent``: of the angle to the furthest star of each cell;
    ``first``: (m + 1,) offsets into ``star``, the rows of the stars, ascending within a cell."""

    middle: Array
    cos_extent: Array
    sin_extent: Array
    first: NDArray[np.int64]
    star: NDArray[np.int64]


def lattice(spacing_rad: float) -> Array:
    """(n, 3) directions distributed evenly over the sphere, about ``spacing_rad`` apart (Fibonacci spiral)."""
    n = max(12, int(np.ceil(4 * np.pi / spacing_rad**2)))
    z = 1 - (2 * np.arange(n) + 1) / n
    flat, turn = np.sqrt(1 - z * z), GOLDEN_RAD * np.arange(n)
    return np.column_stack([flat * np.cos(turn), flat * np.sin(turn), z])


def sky_cells(icrs: Array) -> SkyCells:
    """Group (n, 3) directions by the nearest point of a lattice."""
    count = min(max(len(icrs) // STARS_PER_CELL, 1), MOST_CELLS)
    middle = lattice(float(np.sqrt(4 * np.pi / count)))
    _, cell = cKDTree(middle).query(icrs)
    order = np.argsort(cell, kind="stable")
    first = np.searchsorted(cell[order], np.arange(len(middle) + 1))
    cosine = np.ones(len(middle))
    np.minimum.at(cosine, cell, np.sum(icrs * middle[cell], axis=1))
    extent_rad = np.arccos(np.clip(cosine, -1, 1)) + 1e-9
    return SkyCells(middle, np.cos(extent_rad), np.sin(extent_rad), first.astype(np.int64), order.astype(np.int64))

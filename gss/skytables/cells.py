"""Stars grouped by sky cells, to find the stars near a direction without searching the whole table."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gss.domain.angles import Array

GOLDEN_RAD = np.pi * (3 - 5**0.5)
STARS_PER_CELL, MAX_CELLS = 12, 800
CellArrays = tuple[Array, Array, Array, NDArray[np.int64], NDArray[np.int64], float]


@dataclass(frozen=True)
class SkyCells:
    """Stars grouped into m cells. ``centre``: (m, 3) unit vectors, the points of a :func:`lattice`. ``cos_extent``,
    ``sin_extent``: (m,) cosine and sine of the angle from the centre to the farthest star of the cell; ``widest_rad``:
    the largest of these angles. ``star``: row of each star, grouped by cell, ascending within a cell. ``first``: (m + 1,)
    offsets of the cells in ``star``."""

    centre: Array
    cos_extent: Array
    sin_extent: Array
    first: NDArray[np.int64]
    star: NDArray[np.int64]
    widest_rad: float

    @property
    def arrays(self) -> CellArrays:
        """Return the input of the compiled loops."""
        return self.centre, self.cos_extent, self.sin_extent, self.first, self.star, self.widest_rad


def lattice(spacing_rad: float) -> Array:
    """Return (n, 3) unit vectors distributed evenly over the sphere, about ``spacing_rad`` apart (Fibonacci lattice). Their
    third component falls by 2/n from each to the next."""
    n = max(12, int(np.ceil(4 * np.pi / spacing_rad**2)))
    z = 1 - (2 * np.arange(n) + 1) / n
    radius, angle_rad = np.sqrt(1 - z * z), GOLDEN_RAD * np.arange(n)
    return np.column_stack([radius * np.cos(angle_rad), radius * np.sin(angle_rad), z])


def sky_cells(icrs: Array) -> SkyCells:
    """Group stars with (n, 3) directions by the nearest point of a lattice."""
    count = min(max(len(icrs) // STARS_PER_CELL, 1), MAX_CELLS)
    centre = lattice(float(np.sqrt(4 * np.pi / count)))
    _, cell = cKDTree(centre).query(icrs)
    order = np.argsort(cell, kind="stable")
    first = np.searchsorted(cell[order], np.arange(len(centre) + 1))
    cosine = np.ones(len(centre))
    np.minimum.at(cosine, cell, np.sum(icrs * centre[cell], axis=1))
    extent_rad = np.arccos(np.clip(cosine, -1, 1)) + 1e-9
    cos_extent, sin_extent, widest_rad = np.cos(extent_rad), np.sin(extent_rad), float(extent_rad.max())
    return SkyCells(centre, cos_extent, sin_extent, first.astype(np.int64), order.astype(np.int64), widest_rad)

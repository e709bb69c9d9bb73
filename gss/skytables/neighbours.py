"""Neighbour links: a star list as a network that a search can follow (Moniteq 1983 §6.1).

The stars lie on a sphere, and each edge of their convex hull links two neighbours. All faces are triangles, so n stars
have 3n − 6 links. The document computes the hull with the algorithm of Preparata and Hong, but the result does not
depend on the algorithm.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import ConvexHull, QhullError, cKDTree

from gss.domain.angles import Array, separation_rad
from gss.skytables.pairs import DistanceTable

Index = NDArray[np.intp]
MIN_FOR_A_HULL = 5


@dataclass(frozen=True)
class NeighbourLinks:
    """Neighbour lists of n stars. The neighbours of row r are ``neighbour[start[r]:start[r + 1]]``, ascending. Each
    link is stored at both of its stars."""

    start: Index
    neighbour: Index

    def __len__(self) -> int:
        return len(self.start) - 1

    @property
    def links(self) -> int:
        """Return the number of links, each counted once."""
        return len(self.neighbour) // 2

    def of(self, row: int) -> Index:
        """Return the neighbours of one star."""
        return self.neighbour[self.start[row] : self.start[row + 1]]

    def pairs(self) -> tuple[Index, Index]:
        """Return both ends of each link, the lower row first."""
        owner = np.repeat(np.arange(len(self)), np.diff(self.start))
        once = owner < self.neighbour
        return owner[once], self.neighbour[once]


def neighbour_links(icrs: NDArray[np.floating]) -> NeighbourLinks:
    """Build the neighbour network of (n, 3) unit vectors.

    A star that is not a vertex of the hull (for example at the position of another star) is linked to its nearest star.
    If all stars lie in one plane, there is no hull; each star is then linked to its three nearest stars and to the
    previous row.
    """
    unit = np.asarray(icrs, float)
    n = len(unit)
    if n < MIN_FOR_A_HULL:
        return _net(n, *np.triu_indices(n, 1))
    try:
        face = ConvexHull(unit).simplices
    except QhullError:
        _, nearest = cKDTree(unit).query(unit, 4)
        rows = np.arange(n)
        low, high = np.repeat(rows, 4), np.column_stack([nearest[:, :4], np.maximum(rows - 1, 0)])[:, 1:].ravel()
        other = low != high
        return _net(n, np.minimum(low, high)[other], np.maximum(low, high)[other])
    ends = np.concatenate([face[:, [0, 1]], face[:, [1, 2]], face[:, [2, 0]]])
    outside_hull = np.setdiff1d(np.arange(n), ends)
    if len(outside_hull):
        _, nearest = cKDTree(unit).query(unit[outside_hull], 2)
        other = np.where(nearest[:, 0] == outside_hull, nearest[:, 1], nearest[:, 0])
        ends = np.concatenate([ends, np.stack([outside_hull, other], axis=1)])
    return _net(n, ends.min(axis=1), ends.max(axis=1))


def _net(n: int, low: NDArray[np.integer], high: NDArray[np.integer]) -> NeighbourLinks:
    once = np.unique(np.asarray(low, np.int64) * n + high)
    a, b = np.divmod(once, n)
    owner, other = np.concatenate([a, b]), np.concatenate([b, a])
    order = np.lexsort((other, owner))
    start = np.concatenate([[0], np.cumsum(np.bincount(owner, minlength=n))])
    return NeighbourLinks(start.astype(np.intp), other[order].astype(np.intp))


def link_distances(links: NeighbourLinks, icrs: Array) -> DistanceTable:
    """Return the links of (n, 3) unit vectors as pairs in ascending order of distance."""
    first, second = links.pairs()
    distance_rad = separation_rad(icrs[first], icrs[second])
    order = np.lexsort((second, first, distance_rad))
    a, b = first[order].astype(np.int32), second[order].astype(np.int32)
    return DistanceTable(a, b, distance_rad[order], 0.0, float(np.pi))


@dataclass(frozen=True)
class NeighbourFigures:
    """Statistics of a network: numbers of stars and links; fewest, most and mean neighbours per star.

    ``integers``: length of the linked list (a count and a pointer per star, and each link at both ends: 8n − 12; the
    document prints 8n − 6). ``size_bytes``: size of the list with as many bits per integer as a row number needs.
    """

    stars: int
    links: int
    fewest: int
    most: int
    mean: float
    integers: int
    size_bytes: int


def figures(links: NeighbourLinks) -> NeighbourFigures:
    """Compute the statistics of a network. The document's example has 3000 stars, 12 bits and a catalogue of 70 kbyte."""
    n, degree = len(links), np.diff(links.start)
    integers = 2 * links.links + 2 * n
    bits = max(1, int(np.ceil(np.log2(max(n, 2)))))
    fewest, most = (int(degree.min()), int(degree.max())) if n else (0, 0)
    return NeighbourFigures(
        n, links.links, fewest, most, 2 * links.links / max(n, 1), integers, (integers * bits + 7) // 8
    )

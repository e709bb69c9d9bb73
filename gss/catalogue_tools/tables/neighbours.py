"""Moniteq's linked star catalogue: neighbour links of a star list and their storage size (Moniteq 1983 §6.1)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss.domain.neighbours import NeighbourLinks, neighbour_links
from gss.domain.stars import StarTable


@dataclass(frozen=True)
class NeighbourFigures:
    """Figures of a network: stars, links, fewest, most and mean neighbours.

    ``integers``: length of the linked list (a count and a pointer per star, each link at both ends: 8n − 12; the
    document prints 8n − 6); ``size_bytes``: its size with as many bits per integer as a row number needs.
    """

    stars: int
    links: int
    fewest: int
    most: int
    mean: float
    integers: int
    size_bytes: int


def links_of(stars: StarTable) -> NeighbourLinks:
    """Return the neighbour network of a star list, with the same rows."""
    return neighbour_links(stars.icrs)


def figures(links: NeighbourLinks) -> NeighbourFigures:
    """Compute the figures of a network. The document's example: 3000 stars, 12 bits, a catalogue of 70 kbyte."""
    n, degree = len(links), np.diff(links.start)
    integers = 2 * links.links + 2 * n
    bits = max(1, int(np.ceil(np.log2(max(n, 2)))))
    few, most = (int(degree.min()), int(degree.max())) if n else (0, 0)
    return NeighbourFigures(
        n, links.links, few, most, 2 * links.links / max(n, 1), integers, (integers * bits + 7) // 8
    )

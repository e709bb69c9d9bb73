"""Search for the stars in the new field along links from the stars of the last field (Moniteq 1983 §6.1, Fig. 6.1 step
2b).

On the links of a convex hull, every star except the closest to a point has a neighbour that is closer to this point.
The stars inside a circle are connected by links. Therefore the walk reaches the centre of the field and then spreads to
all stars of the field. It examines about a hundred stars, whereas a linear search examines the whole list.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.skytables.neighbours import NeighbourLinks

Index = NDArray[np.intp]


@dataclass(frozen=True)
class Walk:
    """Result of a walk. ``rows``: rows of the stars in the field, ascending; ``checks``: number of stars examined."""

    rows: Index
    checks: int


def walk(links: NeighbourLinks, icrs: Array, seeds: Index, centre_icrs: Array, radius_rad: float) -> Walk:
    """Find the stars within ``radius_rad`` of a direction, starting from the rows ``seeds`` of the previous field.
    Without seeds, or if the list is too small for links, a linear search is used."""
    if not len(seeds):
        return linear_search(icrs, centre_icrs, radius_rad)
    min_cosine = float(np.cos(radius_rad))
    cosine = {int(r): float(icrs[r] @ centre_icrs) for r in seeds}
    start = _downhill(links, icrs, centre_icrs, max(cosine, key=lambda r: (cosine[r], -r)), cosine)
    queue, inside = deque([start]), {start}
    while queue:
        for other in links.of(queue.popleft()).tolist():
            if other not in cosine:
                cosine[other] = float(icrs[other] @ centre_icrs)
            if cosine[other] >= min_cosine and other not in inside:
                inside.add(other)
                queue.append(other)
    rows = sorted(r for r in inside if cosine[r] >= min_cosine)
    return Walk(np.array(rows, np.intp), len(cosine))


def _downhill(links: NeighbourLinks, icrs: Array, centre: Array, row: int, cosine: dict[int, float]) -> int:
    """Walk from ``row`` to the star nearest the centre; the cosine of every star examined is stored in ``cosine``."""
    while True:
        near = links.of(row).tolist()
        for other in near:
            if other not in cosine:
                cosine[other] = float(icrs[other] @ centre)
        best = max(near, key=lambda r: (cosine[r], -r), default=row)
        if cosine[best] <= cosine[row]:
            return row
        row = best


def linear_search(icrs: Array, centre_icrs: Array, radius_rad: float) -> Walk:
    """Find the stars in the field by examining all stars (Fig. 6.1 step 2a)."""
    return Walk(np.flatnonzero(icrs @ centre_icrs >= np.cos(radius_rad)), len(icrs))

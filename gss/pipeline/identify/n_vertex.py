"""n-vertex match, n = 3, 4, 5: all n(n − 1)/2 baselines of n imaged stars at once (Huffman 2006 §5.5.4).

A set of catalogue stars is consistent if every pair is a candidate of its baseline (matrix S). The document accepts a
unique consistent set. Callers that need more certainty verify the set. A mirrored figure has the opposite sign of the
triple product and is rejected here, but not in the document.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import combinations

import numpy as np

from gss.domain.angles import Array
from gss.pipeline.identify.baselines import Baselines
from gss.pipeline.small import determinant
from gss.skytables.kvector import Rows

FLATTEST = 1e-7


def consistent_names(figure: tuple[int, ...], baselines: Baselines) -> Rows:
    """Return all (m, n) sets of catalogue rows for the imaged stars ``figure`` that are consistent on every baseline."""
    names = baselines.column(figure[0], figure[1]).pairs
    for k in range(2, len(figure)):
        if not len(names):
            break
        names = baselines.extend(names, tuple(baselines.column(other, figure[k]) for other in figure[:k]))
    return names if names.shape[1] == len(figure) else np.empty((0, len(figure)), np.intp)


def same_handed(names: Rows, figure: tuple[int, ...], unit_cam: Array, icrs: Array) -> Rows:
    """Return the sets whose first three stars have the handedness of the imaged stars. Nearly flat figures are not tested."""
    if not len(names):
        return names
    handedness = determinant(unit_cam[list(figure[:3])])
    if abs(handedness) < FLATTEST:
        return names
    return np.asarray(names[np.linalg.det(icrs[names[:, :3]]) * handedness > 0])


def match_figure(figure: tuple[int, ...], baselines: Baselines, unit_cam: Array, icrs: Array) -> Rows:
    """Return the (m, n) consistent sets of catalogue rows with the right handedness. A single set is the document's
    unique match."""
    return same_handed(consistent_names(figure, baselines), figure, unit_cam, icrs)


@lru_cache(maxsize=64)
def figures(stars: int, vertices: int) -> tuple[tuple[int, ...], ...]:
    """Return all figures of ``vertices`` imaged stars (brightest first). Figures with a narrow range of brightness
    ranks come first. Therefore figures that do not contain a particular false star are reached soon.

    The document's loops (§5.5.2) exclude stars in turn, but are ambiguous as printed. This generalises Mortari's triads
    (i, i + dj, i + dj + dk) to any number of stars, ordered by the widest step.
    """
    gaps = sorted(combinations(range(1, stars), vertices - 1), key=lambda gap: (gap[-1:], gap))
    return tuple((i, *(i + g for g in gap)) for gap in gaps for i in range(stars - (gap[-1] if gap else 0)))

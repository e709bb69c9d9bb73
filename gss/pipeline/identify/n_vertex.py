"""n-vertex match, n = 3, 4, 5: all n(n − 1)/2 baselines of n imaged stars at once (Huffman 2006 §5.5.4).

Names are consistent when every pair of them is a candidate of its baseline (matrix S). The document takes a unique
set of names as the answer; callers that want proof verify it. A mirrored figure has the other sign of the triple
product and is left out, which the document does not do.
"""

from __future__ import annotations

from functools import lru_cache
from itertools import combinations

import numpy as np

from gss.domain.angles import Array
from gss.pipeline.identify.baselines import Baselines
from gss.pipeline.identify.sin2_directory import Rows

FLATTEST = 1e-7


def consistent_names(figure: tuple[int, ...], baselines: Baselines) -> Rows:
    """(m, n) all sets of catalogue rows for the imaged stars ``figure`` that agree on every baseline."""
    names = baselines.column(figure[0], figure[1]).pairs()
    for k in range(2, len(figure)):
        if not len(names):
            break
        which, partner = baselines.column(figure[0], figure[k]).partners(names[:, 0])
        names = np.column_stack([names[which], partner])
        for other in range(1, k):
            names = names[baselines.column(figure[other], figure[k]).holds(names[:, other], names[:, k])]
    return names if names.shape[1] == len(figure) else np.empty((0, len(figure)), np.intp)


def same_handed(names: Rows, figure: tuple[int, ...], unit_cam: Array, icrs: Array) -> Rows:
    """The sets whose first three stars turn the way the imaged ones do. Figures too flat to tell are all kept."""
    seen = float(np.linalg.det(unit_cam[list(figure[:3])]))
    if not len(names) or abs(seen) < FLATTEST:
        return names
    return np.asarray(names[np.linalg.det(icrs[names[:, :3]]) * seen > 0])


def match_figure(figure: tuple[int, ...], baselines: Baselines, unit_cam: Array, icrs: Array) -> Rows:
    """(m, n) consistent sets of names with the right handedness; one row is the document's unique match."""
    return same_handed(consistent_names(figure, baselines), figure, unit_cam, icrs)


@lru_cache(maxsize=64)
def figures(stars: int, vertices: int) -> tuple[tuple[int, ...], ...]:
    """All figures of ``vertices`` imaged stars (brightest first), narrow ranges of brightness first, so that a star leaves soon.

    The document's loops (§5.5.2) exclude stars in turn; as printed they are ambiguous. These are Mortari's triads
    (i, i + dj, i + dj + dk) carried on to any number, ordered by the widest step.
    """
    gaps = sorted(combinations(range(1, stars), vertices - 1), key=lambda gap: (gap[-1:], gap))
    return tuple((i, *(i + g for g in gap)) for gap in gaps for i in range(stars - (gap[-1] if gap else 0)))

"""Selection of bank stars for the pair directory: the brightest stars of every field (Huffman 2006 §5.5.4: eight).

This is the coarse on-board version, which uses circles instead of frames on an even lattice of pointings. The ground
version, with real frames in 1° steps and a coverage report, is ``gss.catalogue_tools.selection.uniform_density``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gss.domain.angles import Array
from gss.skytables.cells import lattice


def brightest_per_field(icrs: Array, order: NDArray[np.intp], radius_rad: float, count: int) -> NDArray[np.bool_]:
    """Return the (n,) mask of stars that are among the ``count`` brightest in at least one circle of ``radius_rad``.
    ``order``: (n,) indices, brightest first."""
    chosen = np.zeros(len(order), bool)
    if not len(order):
        return chosen
    ranked = icrs[order]
    in_field = cKDTree(ranked).query_ball_point(
        lattice(radius_rad / 4), 2 * np.sin(min(radius_rad, np.pi) / 2), return_sorted=True
    )
    for inside in in_field:
        chosen[inside[:count]] = True
    selected = np.zeros(len(order), bool)
    selected[order[chosen]] = True
    return selected

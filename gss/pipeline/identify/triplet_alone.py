"""Attitude from a single triplet of stars.

This method is not in Liebe 1992, whose candidates must support each other. In a field of ten stars, often only one star
is far enough from the edge to have a triplet. For such a triplet, the star list is searched for two neighbours of the
candidate at the measured distances.
"""

from __future__ import annotations

import numpy as np

from gss.domain.angles import COSINE_ERROR, Array, cross, separation_rad
from gss.pipeline.attitude import svd


def attitudes_of_triplet(triplet_cam: Array, candidate: int, icrs: Array, tolerance_rad: float) -> list[Array]:
    """Return the (3, 3) attitudes that map a measured triplet to ``candidate`` and two of its neighbours in (m, 3)
    ``icrs`` with the same three distances and handedness. ``triplet_cam``: (3, 3), rows star, nearest, second
    nearest."""
    star, first, second = triplet_cam
    to_first, to_second = float(separation_rad(star, first)), float(separation_rad(star, second))
    reach = max(to_first, to_second) + tolerance_rad
    near = np.flatnonzero(icrs @ icrs[candidate] >= np.cos(min(reach, np.pi)) - COSINE_ERROR)
    distance = separation_rad(icrs[candidate], icrs[near])
    first_rows = near[np.abs(distance - to_first) <= tolerance_rad]
    second_rows = near[np.abs(distance - to_second) <= tolerance_rad]
    i, j = (axis.ravel() for axis in np.meshgrid(first_rows, second_rows, indexing="ij"))
    apart = np.abs(separation_rad(icrs[i], icrs[j]) - separation_rad(first, second))
    sense = np.linalg.det(triplet_cam)
    volume = cross(icrs[i], icrs[j]) @ icrs[candidate]
    # The handedness of nearly collinear triplets is not significant, because position errors can reverse it.
    open_rad3 = tolerance_rad * to_second
    right = (volume * sense > 0) | (np.abs(volume) < open_rad3)
    keep = np.flatnonzero((apart <= tolerance_rad) & (i != j) & (i != candidate) & (j != candidate) & right)
    return [svd(triplet_cam, icrs[[candidate, i[k], j[k]]]) for k in keep.tolist()]

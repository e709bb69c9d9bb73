"""Pairs of measured and predicted stars by least distance (Liebe 1992, "Predictional estimate")."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import COSINE_ERROR, Array, lengths

Index = NDArray[np.intp]


def pair_least_distance(unit_cam: Array, predicted_cam: Array, radius_rad: float) -> tuple[Index, Index]:
    """Pair (n, 3) measured with (m, 3) predicted directions. Returns the rows of the pairs. Each row is used at most
    once.

    The closest pair is chosen first, then the closest pair of the remaining stars, up to ``radius_rad``. Of equal
    distances, the lower rows are chosen. The document pairs the stars of the two images by least distance without
    further rules.
    """
    none = np.empty(0, np.intp)
    if not len(unit_cam) or not len(predicted_cam):
        return none, none
    limit = 2 * np.sin(radius_rad / 2)
    # The cosine is computed faster than the chord, but has too few digits for small angles.
    i, j = np.nonzero(unit_cam @ predicted_cam.T >= 1 - limit**2 / 2 - COSINE_ERROR)
    chord = lengths(unit_cam[i] - predicted_cam[j])
    near = chord <= limit
    i, j, chord = i[near], j[near], chord[near]
    order = np.argsort(chord, kind="stable")
    free_i, free_j = np.ones(len(unit_cam), bool), np.ones(len(predicted_cam), bool)
    pairs: list[int] = []
    for k in order.tolist():
        if free_i[i[k]] and free_j[j[k]]:
            free_i[i[k]] = free_j[j[k]] = False
            pairs.append(k)
    pairs.sort(key=lambda k: int(i[k]))
    return i[pairs], j[pairs]

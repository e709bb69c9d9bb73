"""Compiled pairing of predicted stars with detections; equivalent to ``verify.pair_up``."""

# The loops have no type annotations: numba compiles them for the argument types.
# mypy: allow-untyped-defs

from __future__ import annotations

import math

import numpy as np

from gss.pipeline.loops import loop


@loop
def by_column(pixels):
    """Return the order of (n, 2) pixels by column, and their columns in this order."""
    order = np.argsort(pixels[:, 0])
    return order, pixels[order, 0]


@loop
def pair_up(places, radius, predicted, pixels, order, column, to, back):
    """Pair the first ``predicted`` stars with detections that are mutually nearest and within the star's radius. Write the
    detection of each star, or -1, to ``to``. ``back``: nearest star of each detection among the stars within reach, valid only
    for the pairs in ``to``. ``order`` and ``column``: result of :func:`by_column`.

    Detections further than the largest radius from a star are not examined, because they cannot be its pair.
    """
    back[:] = -1
    back_d2, reach = np.full(len(pixels), math.inf), 0.0
    for p in range(predicted):
        reach = max(reach, radius[p])
    for p in range(predicted):
        nearest, nearest_d2 = -1, math.inf
        for k in range(np.searchsorted(column, places[p, 0] - reach), len(column)):
            if column[k] > places[p, 0] + reach:
                break
            m = order[k]
            across, down = places[p, 0] - pixels[m, 0], places[p, 1] - pixels[m, 1]
            d2 = across * across + down * down
            if d2 < nearest_d2 or (d2 == nearest_d2 and m < nearest):
                nearest, nearest_d2 = m, d2
            if d2 < back_d2[m]:
                back[m], back_d2[m] = p, d2
        to[p] = nearest if nearest_d2 <= radius[p] * radius[p] else -1
    for p in range(predicted):
        if to[p] >= 0 and back[to[p]] != p:
            to[p] = -1

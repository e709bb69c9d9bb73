"""Pivoting: the angle method with further stars until one solution is left (Huffman 2006 §5.4.1).

The document compares only the angles from one star, the hub, to the others. Two angles that have a common star do not fix the
third side, so callers that need more certainty verify the result.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from gss.pipeline.identify.baselines import Baselines
from gss.skytables.kvector import Rows

LEAST_STARS = 3


def pivoted(order: tuple[int, ...], baselines: Baselines) -> tuple[tuple[int, ...], Rows]:
    """Match the pair of the first two imaged stars of ``order``, then pair the first star with one further star after the
    other until at most one solution is left. Returns the stars used and the (m, used) sets of catalogue rows."""
    names = baselines.column(order[0], order[1]).pairs
    used = 2
    while used < len(order) and len(names) and (used < LEAST_STARS or len(names) > 1):
        index, partner = baselines.column(order[0], order[used]).partners(names[:, 0])
        names = np.column_stack([names[index], partner])
        used += 1
    return order[:used], names


def pivot_orders(stars: int) -> Iterator[tuple[int, ...]]:
    """Yield orders of the imaged stars, brightest first: each star as the hub, with the others beginning at each star.
    The false stars in a frame are therefore not among the first stars of every order."""
    for first in range(stars - 1):
        for hub in range(stars):
            others = [k for k in range(stars) if k != hub]
            yield (hub, *others[first:], *others[:first])

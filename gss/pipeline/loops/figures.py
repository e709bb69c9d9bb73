"""Compiled extension of figures of stars; equivalent to ``baselines.extended``."""

# The loops have no type annotations: numba compiles them for the argument types.
# mypy: allow-untyped-defs

from __future__ import annotations

import numpy as np

from gss.pipeline.identify.baselines import BaselineCandidates
from gss.pipeline.loops import loop
from gss.pipeline.small import Rows


def extended(names: Rows, columns: tuple[BaselineCandidates, ...]) -> Rows:
    """Return the sets with one more star. Arguments as in ``baselines.extended``."""
    keys = tuple(column.key for column in columns)
    return np.asarray(_extended(names, keys, columns[0].stars))


@loop
def _extended(names, keys, stars):
    vertices = len(keys)
    sets, count = np.empty((max(len(names), 16), vertices + 1), np.int64), 0
    for i in range(len(names)):
        key = names[i, 0] * stars
        for e in range(np.searchsorted(keys[0], key), len(keys[0])):
            partner = keys[0][e] - key
            if partner >= stars:
                break
            if not _agree(names, i, partner, keys, stars):
                continue
            if count == len(sets):
                sets = np.concatenate((sets, np.empty_like(sets)))
            sets[count, :vertices] = names[i]
            sets[count, vertices] = partner
            count += 1
    return sets[:count]


@loop
def _agree(names, i, partner, keys, stars):
    """True if the partner is a candidate of the baselines from all further stars of the set."""
    for other in range(1, len(keys)):
        key = names[i, other] * stars + partner
        at = np.searchsorted(keys[other], key)
        if at == len(keys[other]) or keys[other][at] != key:
            return False
    return True

"""What changes between two catalogues, before one replaces the other on board."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array, separation_rad
from gss.domain.stars import Ids, OnboardCatalogue

# Below both formats' own number widths nothing has moved.
MOVED_RAD = 5e-7
MAGNITUDE_CHANGED_MAG = 0.005


@dataclass(frozen=True)
class CatalogueDiff:
    """``added``, ``dropped``: Hipparcos numbers, ascending. ``moved``: common stars that moved more than the number widths,
    with ``moved_rad``; ``magnitude_changed``: common stars whose V changed. ``pairs``: old and new number."""

    added: Ids
    dropped: Ids
    same: Ids
    moved: Ids
    moved_rad: Array
    magnitude_changed: Ids
    pairs: tuple[int, int]


def compare(old: OnboardCatalogue, new: OnboardCatalogue) -> CatalogueDiff:
    """The difference of two decoded bank images; both need their Hipparcos numbers."""
    common, at_old, at_new = np.intersect1d(old.hip, new.hip, assume_unique=True, return_indices=True)
    shift = separation_rad(_unit(old.icrs[at_old]), _unit(new.icrs[at_new]))
    moved = shift > MOVED_RAD
    change = np.abs(new.v_mag[at_new].astype(float) - old.v_mag[at_old].astype(float))
    return CatalogueDiff(
        added=np.setdiff1d(new.hip, old.hip).astype(np.int32),
        dropped=np.setdiff1d(old.hip, new.hip).astype(np.int32),
        same=common[~moved].astype(np.int32),
        moved=common[moved].astype(np.int32),
        moved_rad=shift[moved],
        magnitude_changed=common[change > MAGNITUDE_CHANGED_MAG].astype(np.int32),
        pairs=(len(old.distances), len(new.distances)),
    )


def _unit(vectors: NDArray[np.floating]) -> Array:
    """Single-precision vectors are not quite of length one."""
    v = np.asarray(vectors, float)
    return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))

"""Differences between two catalogues, shown before one replaces the other on board."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gss.catalogue_tools.envelope.healpix import centres
from gss.domain.angles import Array, separation_rad
from gss.domain.errors import BadInput
from gss.domain.stars import Ids
from gss.skytables.bank import OnboardCatalogue

# Position resolution of the formats. A star that is shifted by less has not moved.
MOVED_RAD = 5e-7
MAGNITUDE_CHANGED_MAG = 0.005
COVERAGE_NSIDE = 16


@dataclass(frozen=True)
class CatalogueDiff:
    """Result of :func:`compare`.

    ``added``, ``dropped``: Hipparcos numbers, ascending. ``moved``: common stars that moved by more than the position
    resolution, with ``moved_rad``. ``magnitude_changed``: common stars whose V changed, with ``magnitude_change_mag``
    (new − old). ``pairs``: number of pairs (old, new). ``unknown``: number of rows (old, new) without a unique
    catalogue number, which are not compared.
    """

    added: Ids
    dropped: Ids
    same: Ids
    moved: Ids
    moved_rad: Array
    magnitude_changed: Ids
    magnitude_change_mag: Array
    pairs: tuple[int, int]
    unknown: tuple[int, int] = (0, 0)

    @property
    def nothing(self) -> bool:
        """True if both catalogues have the same stars, positions, magnitudes and number of pairs, and no unknown
        rows."""
        changed = len(self.added) + len(self.dropped) + len(self.moved) + len(self.magnitude_changed)
        return not changed and self.pairs[0] == self.pairs[1] and self.unknown == (0, 0)


@dataclass(frozen=True)
class CoverageChange:
    """``old``, ``new``: (12·nside²,) number of stars within ``radius_rad`` of each HEALPix pixel centre (ring
    order)."""

    nside: int
    radius_rad: float
    old: NDArray[np.int64]
    new: NDArray[np.int64]

    def poorer(self, stars: int) -> int:
        """Return the number of circles that had at least ``stars`` stars and now have fewer."""
        return int(np.count_nonzero((self.old >= stars) & (self.new < stars)))


def compare(old: OnboardCatalogue, new: OnboardCatalogue) -> CatalogueDiff:
    """Compare two decoded bank images. Both must have Hipparcos numbers."""
    known_old, known_new = _numbered_rows(old), _numbered_rows(new)
    common, at_old, at_new = np.intersect1d(old.hip[known_old], new.hip[known_new], return_indices=True)
    row_old, row_new = known_old[at_old], known_new[at_new]
    shift = separation_rad(_unit(old.icrs[row_old]), _unit(new.icrs[row_new]))
    moved = shift > MOVED_RAD
    change = new.v_mag[row_new].astype(float) - old.v_mag[row_old].astype(float)
    brighter = np.abs(change) > MAGNITUDE_CHANGED_MAG
    return CatalogueDiff(
        added=np.setdiff1d(new.hip[known_new], old.hip).astype(np.int32),
        dropped=np.setdiff1d(old.hip[known_old], new.hip).astype(np.int32),
        same=common[~moved].astype(np.int32),
        moved=common[moved].astype(np.int32),
        moved_rad=shift[moved],
        magnitude_changed=common[brighter].astype(np.int32),
        magnitude_change_mag=change[brighter],
        pairs=(len(old.distances), len(new.distances)),
        unknown=(len(old) - len(known_old), len(new) - len(known_new)),
    )


def coverage_change(
    old: OnboardCatalogue, new: OnboardCatalogue, radius_rad: float, nside: int = COVERAGE_NSIDE
) -> CoverageChange:
    """Count the stars around each HEALPix pixel before and after, in circles the size of a field of view."""
    if not 0 < radius_rad <= np.pi:
        raise BadInput("the radius is out of range", expected="more than 0°, at most 180°", got=f"{radius_rad}")
    chord, where = 2 * np.sin(radius_rad / 2), centres(nside)
    counts = [
        np.asarray(cKDTree(_unit(c.icrs)).query_ball_point(where, chord, return_length=True), np.int64)
        if len(c)
        else np.zeros(len(where), np.int64)
        for c in (old, new)
    ]
    return CoverageChange(nside, radius_rad, counts[0], counts[1])


def _numbered_rows(catalogue: OnboardCatalogue) -> NDArray[np.intp]:
    """Return the rows with a catalogue number. If rows share a number, only the first of them is returned."""
    numbers, first = np.unique(catalogue.hip, return_index=True)
    return np.sort(first[numbers >= 0])


def _unit(vectors: NDArray[np.floating]) -> Array:
    """Normalise vectors. The length of vectors stored in single precision is not exactly one."""
    v = np.asarray(vectors, float)
    return np.asarray(v / np.linalg.norm(v, axis=-1, keepdims=True))

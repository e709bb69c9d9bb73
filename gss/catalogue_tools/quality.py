"""How well the stars on board fill the fields that will be seen (Jacobs 1995 §5.1: random pointings, counted)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gss.catalogue_tools.envelope import Envelope
from gss.catalogue_tools.field import Disc, FieldShape
from gss.domain.angles import Array
from gss.domain.frames import ra_dec_roll_rad
from gss.domain.stars import DistanceTable

BLOCK = 8192
Counts = NDArray[np.int64]


@dataclass(frozen=True)
class Quality:
    """``histogram``: how many pointings had 0, 1, 2 … stars. ``worst_*``: the first pointing with the fewest stars.
    ``candidates_per_query``: mean length of a distance query, NaN without a table."""

    pointings: int
    histogram: NDArray[np.int64]
    worst_stars: int
    worst_ra_rad: float
    worst_dec_rad: float
    worst_roll_rad: float
    candidates_per_query: float

    @property
    def mean(self) -> float:
        """Mean number of stars per field."""
        return float(self.histogram @ np.arange(len(self.histogram)) / self.pointings)

    def p_fewer_than(self, stars: int) -> float:
        """Share of the pointings with fewer stars."""
        return float(self.histogram[:stars].sum() / self.pointings)


def assess(
    unit: Array,
    envelope: Envelope,
    shape: FieldShape,
    pointings: int,
    rng: np.random.Generator,
    distances: DistanceTable | None = None,
    tolerance_rad: float = 0.0,
    each: Callable[..., Iterable[Counts]] = map,
) -> Quality:
    """Count (n, 3) ICRS stars in random fields of the envelope. ``shape``: the field without any margin. ``each``: as for
    :func:`stars_per_field`."""
    attitudes = envelope.attitudes(rng, pointings)
    counts = stars_per_field(unit, attitudes, shape, each)
    worst = int(np.argmin(counts))
    ra, dec, roll = ra_dec_roll_rad(attitudes[worst])
    candidates = float("nan") if distances is None else candidates_per_query(distances, tolerance_rad)
    return Quality(pointings, np.bincount(counts), int(counts[worst]), ra, dec, roll, candidates)


def stars_per_field(
    unit: Array, attitudes: Array, shape: FieldShape | Disc, each: Callable[..., Iterable[Counts]] = map
) -> Counts:
    """(m,) numbers of (n, 3) ICRS stars in the fields of (m, 3, 3) cam_from_icrs. ``each``: how blocks are worked off:
    ``map``, or that of a pool of threads, which the work inside lets run side by side."""
    if not len(unit) or not len(attitudes):
        return np.zeros(len(attitudes), np.int64)
    tree = cKDTree(unit)
    starts = range(0, len(attitudes), BLOCK)
    return np.concatenate(list(each(lambda s: _count(unit, tree, attitudes[s : s + BLOCK], shape), starts)))


def _count(unit: Array, tree: cKDTree, attitudes: Array, shape: FieldShape | Disc) -> Counts:
    reach = 2 * np.sin(min(shape.half_diagonal_rad, np.pi) / 2) * (1 + 1e-9)
    near = cKDTree(attitudes[:, 2]).sparse_distance_matrix(tree, reach, output_type="ndarray")
    field, star = near["i"], near["j"]
    seen = shape.inside(np.einsum("nij,nj->ni", attitudes[field], unit[star]))
    return np.bincount(field[seen], minlength=len(attitudes))


def candidates_per_query(distances: DistanceTable, tolerance_rad: float) -> float:
    """Mean number of table entries within ± tolerance of an entry's own distance: what a matcher has to look through."""
    if not len(distances):
        return 0.0
    d = np.asarray(distances.distance_rad, float)
    return float(
        np.mean(np.searchsorted(d, d + tolerance_rad, "right") - np.searchsorted(d, d - tolerance_rad, "left"))
    )

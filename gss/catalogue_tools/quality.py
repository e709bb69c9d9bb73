"""How well the stars on board fill the fields that will be seen (Jacobs 1995 §5.1: random pointings, counted)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.catalogue_tools.counting import Counts, stars_per_field
from gss.catalogue_tools.envelope import Envelope
from gss.catalogue_tools.field import FieldShape
from gss.domain.angles import Array
from gss.domain.frames import ra_dec_roll_rad
from gss.domain.stars import DistanceTable

__all__ = ["Counts", "Quality", "assess", "candidates_per_query", "stars_per_field"]


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


def candidates_per_query(distances: DistanceTable, tolerance_rad: float) -> float:
    """Mean number of table entries within ± tolerance of an entry's own distance: what a matcher has to look through."""
    if not len(distances):
        return 0.0
    d = np.asarray(distances.distance_rad, float)
    return float(
        np.mean(np.searchsorted(d, d + tolerance_rad, "right") - np.searchsorted(d, d - tolerance_rad, "left"))
    )

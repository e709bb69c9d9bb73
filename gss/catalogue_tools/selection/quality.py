"""Statistics of stars per field over the envelope, counted at random pointings (Jacobs 1995 §5.1)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.catalogue_tools.envelope.envelope import Envelope
from gss.catalogue_tools.envelope.field import FieldShape
from gss.catalogue_tools.envelope.occultation import OccultedEnvelope
from gss.catalogue_tools.selection.counting import Counts, stars_per_field
from gss.catalogue_tools.selection.poorest import search_poorest
from gss.domain.angles import Array
from gss.domain.frames import ra_dec_roll_rad
from gss.skytables.pairs import DistanceTable

__all__ = ["Counts", "Quality", "assess", "candidates_per_query", "stars_per_field"]


@dataclass(frozen=True)
class Quality:
    """Stars per field and look-up cost of a catalogue.

    ``histogram``: number of pointings with 0, 1, 2 … stars. ``worst_*``: the field with the fewest stars among these
    pointings and ``searched`` further fields around the poorest pointings. ``candidates_per_query``: mean number of
    pairs that a distance query returns. ``candidates_per_star``: number of catalogue stars in the results of all
    queries of one observed star; NaN without a table. ``blinded_share``: fraction of the time lost to Earth, Sun or
    Moon; the pointings cover the remaining time.
    """

    pointings: int
    histogram: NDArray[np.int64]
    worst_stars: int
    worst_ra_rad: float
    worst_dec_rad: float
    worst_roll_rad: float
    candidates_per_query: float
    candidates_per_star: float = float("nan")
    blinded_share: float = 0.0
    searched: int = 0

    @property
    def mean(self) -> float:
        """Mean number of stars per field."""
        return float(self.histogram @ np.arange(len(self.histogram)) / self.pointings)

    def p_fewer_than(self, stars: int) -> float:
        """Fraction of the pointings with fewer than ``stars`` stars."""
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
    """Count (n, 3) ICRS stars in random fields of the envelope.

    ``shape``: field of view without the margin. ``each``: as for :func:`stars_per_field`.
    """
    if isinstance(envelope, OccultedEnvelope):
        moments = envelope.usable_moments(rng, pointings)
        attitudes, shadow, blinded = moments.cam_from_icrs, envelope.shadow(moments), envelope.blinded.total
    else:
        attitudes, shadow, blinded = envelope.attitudes(rng, pointings), None, 0.0
    counts = stars_per_field(unit, attitudes, shape, each, shadow)
    poorest = search_poorest(unit, envelope, shape)
    first = int(np.argmin(counts))
    worst, stars = (
        (poorest.cam_from_icrs, poorest.stars) if poorest.stars < counts[first] else (attitudes[first], counts[first])
    )
    ra, dec, roll = ra_dec_roll_rad(worst)
    query = float("nan") if distances is None else candidates_per_query(distances, tolerance_rad)
    per_star = candidates_per_star(len(unit), query, float(counts.mean()))
    return Quality(
        pointings, np.bincount(counts), int(stars), ra, dec, roll, query, per_star, blinded, poorest.searched
    )


def candidates_per_star(stars: int, per_query: float, per_field: float) -> float:
    """Return the expected number of different stars in the results of the queries of one star with each other star of
    its field.

    Each query returns pairs. All stars are assumed to occur in these pairs with equal probability.
    """
    if stars < 1 or not np.isfinite(per_query):
        return float("nan")
    queries = max(per_field - 1, 0.0)
    return float(stars * -np.expm1(queries * per_query * np.log1p(-min(2 / stars, 1 - 1e-12))))


def candidates_per_query(distances: DistanceTable, tolerance_rad: float) -> float:
    """Return the mean number of table entries within ± tolerance of an entry's distance, which a matcher has to
    examine."""
    if not len(distances):
        return 0.0
    d = np.asarray(distances.distance_rad, float)
    low, high = distances.ranges(d - tolerance_rad, d + tolerance_rad)
    return float(np.mean(high - low))

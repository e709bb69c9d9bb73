"""Compiled count of the spots that support a pair of stars; equivalent to ``neighbour_pattern.supporters``."""

# The loops have no type annotations: numba compiles them for the argument types.
# mypy: allow-untyped-defs

from __future__ import annotations

import math

import numpy as np

from gss.domain.angles import Array
from gss.pipeline.identify.neighbour_pattern import MAX_AMPLIFIED, ROUNDING, PairHypotheses, PatternSpots, PatternStars
from gss.pipeline.loops import loop
from gss.pipeline.loops.cells import stars_near
from gss.pipeline.loops.fit import turned
from gss.pipeline.small import Rows


def supporters(
    spots: PatternSpots,
    h: PairHypotheses,
    attitudes: Array,
    stars: PatternStars,
    tolerance_rad: float,
    error_mag: float,
) -> Rows:
    """Return the number of supporting spots of each hypothesis. Arguments as in ``neighbour_pattern.supporters``."""
    count = np.zeros(len(h), np.int64)
    if not len(h):
        return count
    _supporters(
        (np.ascontiguousarray(spots.unit), spots.mag, spots.saturated),
        (h.i, h.j, np.ascontiguousarray(attitudes)),
        (stars.icrs, stars.v_mag, stars.cells.arrays),
        float(tolerance_rad),
        float(error_mag),
        count,
    )
    return count


@loop
def _supporters(spots, pairs, stars, tolerance_rad, error_mag, count):
    """Write the number of supporting spots of each hypothesis to ``count``. ``spots``: directions, magnitudes, saturation.
    ``pairs``: first and second spot, attitude. ``stars``: directions, magnitudes, sky cells."""
    unit, mag, saturated = spots
    first, second, attitudes = pairs
    icrs, star_mag, cells = stars
    reach_rad = MAX_AMPLIFIED * tolerance_rad
    cosine = math.cos(min(math.acos(min(unit[:, 2].min(), 1.0)) + 1.01 * reach_rad, math.pi))
    near, predicted = np.empty(len(icrs), np.int64), np.empty((len(icrs), 3))
    middle = np.empty(3)
    for k in range(len(count)):
        turn, p, q = attitudes[k], unit[first[k]], unit[second[k]]
        visible = stars_near(icrs, cells, turn[2], cosine, len(icrs), near)
        for m in range(visible):
            s = near[m]
            predicted[m, 0], predicted[m, 1], predicted[m, 2] = turned(turn, icrs[s, 0], icrs[s, 1], icrs[s, 2])
        length = math.sqrt((p[0] + q[0]) ** 2 + (p[1] + q[1]) ** 2 + (p[2] + q[2]) ** 2)
        for i in range(3):
            middle[i] = (p[i] + q[i]) / length
        apart = max(math.sqrt(_chord2(p, q)), 1e-12)
        for spot in range(len(unit)):
            star, closest2 = -1, reach_rad * reach_rad * ROUNDING**2
            for m in range(visible):
                chord2 = _chord2(unit[spot], predicted[m])
                if chord2 < closest2:
                    star, closest2 = near[m], chord2
            if star < 0:
                continue
            lever = math.sqrt(_chord2(unit[spot], middle)) / apart
            allowed_rad = tolerance_rad * min(max(1.0, 2 * lever), MAX_AMPLIFIED)
            if math.sqrt(closest2) <= allowed_rad and _magnitude_fits(
                mag[spot], saturated[spot], star_mag[star], error_mag
            ):
                count[k] += 1


@loop
def _chord2(p, q):
    return (p[0] - q[0]) ** 2 + (p[1] - q[1]) ** 2 + (p[2] - q[2]) ** 2


@loop
def _magnitude_fits(spot_mag, saturated, star_mag, error_mag):
    """Equivalent to ``neighbour_pattern.magnitude_fits``."""
    return not star_mag - spot_mag > error_mag and (not spot_mag - star_mag > error_mag or saturated)

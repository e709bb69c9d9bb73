"""Blind search for a pattern of linked neighbours (Moniteq 1983 §6.1, Fig. 6.1 step 3).

Two spots and two linked stars form a hypothesis if separation and brightness agree. The hypothesis defines an
attitude. Other spots that coincide with stars at this attitude support the hypothesis. The brightest spots are tried
first because they have the fewest candidates. The number of hypotheses is limited.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from gss.domain.angles import Array, lengths, separation_rad
from gss.skytables.pairs import DistanceTable, expanded

Index = NDArray[np.intp]
Mask = NDArray[np.bool_]
CHUNK = 512
MAX_AMPLIFIED = 3.0


@dataclass(frozen=True)
class PairHypotheses:
    """List of h hypotheses: spot ``i`` is star ``a`` and spot ``j`` is star ``b``; ``checks``: number of links
    examined, ``left_out``: number of hypotheses not tried."""

    i: Index
    j: Index
    a: Index
    b: Index
    checks: int
    left_out: int

    def __len__(self) -> int:
        return len(self.i)


def magnitude_fits(spot_mag: Array, saturated: Mask, star_mag: Array, error_mag: float) -> Mask:
    """True for each spot whose brightness agrees with its star (arrays of equal shape). An unknown magnitude fits any star,
    and a ``saturated`` spot also fits brighter stars."""
    too_faint, too_bright = spot_mag - star_mag > error_mag, star_mag - spot_mag > error_mag
    return np.asarray(~too_bright & (~too_faint | saturated))


def pair_hypotheses(
    unit_cam: Array,
    spot_mag: Array,
    saturated: Mask,
    links: DistanceTable,
    star_mag: Array,
    allowed: Mask,
    tolerance_rad: float,
    error_mag: float,
    max_hypotheses: int,
) -> PairHypotheses:
    """Return at most ``max_hypotheses`` matches of pairs of (n, 3) spots, brightest first, with links of ``allowed``
    stars."""
    i, j = np.triu_indices(len(unit_cam), 1)
    # The pairs of the brightest spots are first: 01, 02, 12, 03 …
    order = np.lexsort((i, j))
    i, j = i[order], j[order]
    apart = separation_rad(unit_cam[i], unit_cam[j])
    pair, link = expanded(*links.ranges(apart - tolerance_rad, apart + tolerance_rad))
    checks = len(link)
    first, second = links.first[link].astype(np.intp), links.second[link].astype(np.intp)
    keep = allowed[first] & allowed[second]
    pair, first, second = pair[keep], first[keep], second[keep]
    both_orders = np.stack([np.stack([first, second], 1), np.stack([second, first], 1)], 1).reshape(-1, 2)
    pair = np.repeat(pair, 2)
    fits = magnitude_fits(spot_mag[i[pair]], saturated[i[pair]], star_mag[both_orders[:, 0]], error_mag)
    fits &= magnitude_fits(spot_mag[j[pair]], saturated[j[pair]], star_mag[both_orders[:, 1]], error_mag)
    index = np.flatnonzero(fits)
    used = index[:max_hypotheses]
    return PairHypotheses(
        i[pair[used]], j[pair[used]], both_orders[used, 0], both_orders[used, 1], checks, len(index) - len(used)
    )


def pair_attitudes(unit_cam: Array, icrs: Array, h: PairHypotheses) -> Array:
    """Return the (h, 3, 3) attitudes that align midpoint and direction of each pair of spots with those of its stars."""
    camera_axes, icrs_axes = _axes(unit_cam[h.i], unit_cam[h.j]), _axes(icrs[h.a], icrs[h.b])
    return np.asarray(np.einsum("hka,hkb->hab", camera_axes, icrs_axes))


def _axes(p: Array, q: Array) -> Array:
    """Return (h, 3, 3) axes with rows midpoint, across, along."""
    middle = p + q
    middle /= lengths(middle)[:, None]
    across = np.cross(p, q)
    across /= np.maximum(lengths(across)[:, None], 1e-300)
    return np.stack([middle, across, np.cross(middle, across)], axis=1)


def supporters(
    unit_cam: Array,
    spot_mag: Array,
    saturated: Mask,
    h: PairHypotheses,
    attitudes: Array,
    icrs: Array,
    tree: cKDTree,
    star_mag: Array,
    tolerance_rad: float,
    error_mag: float,
) -> NDArray[np.intp]:
    """Return, for each hypothesis, the number of spots that coincide with a star of similar brightness at its attitude
    (h,).

    A close pair determines the roll poorly, so the tolerance grows with the distance from its midpoint, up to a factor
    of three.
    """
    count = np.zeros(len(h), np.intp)
    for begin in range(0, len(h), CHUNK):
        part = slice(begin, begin + CHUNK)
        sky = unit_cam @ attitudes[part]
        # Most spots are far from every star, and a search of limited distance ends sooner.
        distance, star = tree.query(sky, distance_upper_bound=(1 + 1e-9) * MAX_AMPLIFIED * tolerance_rad)
        hypothesis, spot = np.nonzero(np.isfinite(distance))
        star_of_spot = star[hypothesis, spot]
        first, second = unit_cam[h.i[part][hypothesis]], unit_cam[h.j[part][hypothesis]]
        middle = first + second
        middle /= lengths(middle)[:, None]
        lever = lengths(unit_cam[spot] - middle) / np.maximum(lengths(first - second), 1e-12)
        allowed_rad = tolerance_rad * np.minimum(np.maximum(1.0, 2 * lever), MAX_AMPLIFIED)
        fits = magnitude_fits(spot_mag[spot], saturated[spot], star_mag[star_of_spot], error_mag)
        fits &= distance[hypothesis, spot] <= allowed_rad
        count[part] = np.bincount(hypothesis[fits], minlength=len(sky))
    return count

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

from gss.domain.angles import Array, cross, lengths, separation_rad
from gss.pipeline.kernels import kernels
from gss.skytables.cells import SkyCells, sky_cells
from gss.skytables.pairs import DistanceTable, expanded

Index = NDArray[np.intp]
Mask = NDArray[np.bool_]
CHUNK = 512
MAX_AMPLIFIED = 3.0
ROUNDING = 1 + 1e-9
"""Factor of the largest distance of a search, so that a star exactly at this distance is found."""


@dataclass(frozen=True)
class PatternSpots:
    """Centroids with a direction: ``index`` (n,) in the frame's list, ``unit`` (n, 3) in the camera frame, ``mag`` (n,),
    ``saturated`` (n,)."""

    index: Index
    unit: Array
    mag: Array
    saturated: Mask

    def __len__(self) -> int:
        return len(self.index)


@dataclass(frozen=True)
class PatternStars:
    """Stars of a bank: directions (m, 3), magnitudes (m,), a tree for the nearest star, and sky cells for the compiled
    loops."""

    icrs: Array
    v_mag: Array
    tree: cKDTree
    cells: SkyCells


def pattern_stars(icrs: Array, v_mag: Array) -> PatternStars:
    """Prepare the search for stars at (m, 3) directions."""
    return PatternStars(icrs, v_mag, cKDTree(icrs), sky_cells(icrs))


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
    spots: PatternSpots,
    links: DistanceTable,
    star_mag: Array,
    allowed: Mask,
    tolerance_rad: float,
    error_mag: float,
    max_hypotheses: int,
) -> PairHypotheses:
    """Return at most ``max_hypotheses`` matches of pairs of spots, brightest first, with links of ``allowed`` (m,) stars
    with magnitudes ``star_mag`` (m,)."""
    i, j = np.triu_indices(len(spots), 1)
    # The pairs of the brightest spots are first: 01, 02, 12, 03 …
    order = np.lexsort((i, j))
    i, j = i[order], j[order]
    apart = separation_rad(spots.unit[i], spots.unit[j])
    i, j, apart = i[apart > 0], j[apart > 0], apart[apart > 0]  # two spots at the same place give no direction
    pair, link = expanded(*links.ranges(apart - tolerance_rad, apart + tolerance_rad))
    checks = len(link)
    first, second = links.first[link].astype(np.intp), links.second[link].astype(np.intp)
    keep = allowed[first] & allowed[second]
    pair, first, second = pair[keep], first[keep], second[keep]
    i, j = i[pair], j[pair]
    both_orders = np.stack(
        [
            magnitude_fits(spots.mag[i], spots.saturated[i], star_mag[a], error_mag)
            & magnitude_fits(spots.mag[j], spots.saturated[j], star_mag[b], error_mag)
            for a, b in ((first, second), (second, first))
        ],
        axis=1,
    )
    index = np.flatnonzero(both_orders)
    used, swapped = np.divmod(index[:max_hypotheses], 2)
    a, b = np.where(swapped, second[used], first[used]), np.where(swapped, first[used], second[used])
    return PairHypotheses(i[used], j[used], a, b, checks, len(index) - len(used))


def pair_attitudes(unit_cam: Array, icrs: Array, h: PairHypotheses) -> Array:
    """Return the (h, 3, 3) attitudes that align midpoint and direction of each pair of spots with those of its stars."""
    camera_axes, icrs_axes = _axes(unit_cam[h.i], unit_cam[h.j]), _axes(icrs[h.a], icrs[h.b])
    return np.asarray(np.einsum("hka,hkb->hab", camera_axes, icrs_axes))


def _axes(p: Array, q: Array) -> Array:
    """Return (h, 3, 3) axes with rows midpoint, across, along."""
    middle = p + q
    middle /= lengths(middle)[:, None]
    across = cross(p, q)
    across /= np.maximum(lengths(across)[:, None], 1e-300)
    return np.stack([middle, across, cross(middle, across)], axis=1)


def supporters(
    spots: PatternSpots,
    h: PairHypotheses,
    attitudes: Array,
    stars: PatternStars,
    tolerance_rad: float,
    error_mag: float,
    fast: bool | None = None,
) -> NDArray[np.intp]:
    """Return, for each hypothesis, the number of spots that coincide with a star of similar brightness at its attitude
    (h,). ``attitudes``: (h, 3, 3); ``fast``: see ``kernels.kernels``. The directions are finite. Of two stars at the same
    place, either is compared.

    A close pair determines the roll poorly, so the tolerance grows with the distance from its midpoint, up to a factor
    of three.
    """
    loops = kernels(fast).lists
    if loops is not None:
        return loops.supporters(spots, h, attitudes, stars, tolerance_rad, error_mag)
    count = np.zeros(len(h), np.intp)
    for begin in range(0, len(h), CHUNK):
        part = slice(begin, begin + CHUNK)
        sky = spots.unit @ attitudes[part]
        # Most spots are far from every star, and a search of limited distance ends sooner.
        distance, star = stars.tree.query(sky, distance_upper_bound=ROUNDING * MAX_AMPLIFIED * tolerance_rad)
        hypothesis, spot = np.nonzero(np.isfinite(distance))
        star_of_spot = star[hypothesis, spot]
        first, second = spots.unit[h.i[part][hypothesis]], spots.unit[h.j[part][hypothesis]]
        middle = first + second
        middle /= lengths(middle)[:, None]
        lever = lengths(spots.unit[spot] - middle) / np.maximum(lengths(first - second), 1e-12)
        allowed_rad = tolerance_rad * np.minimum(np.maximum(1.0, 2 * lever), MAX_AMPLIFIED)
        fits = magnitude_fits(spots.mag[spot], spots.saturated[spot], stars.v_mag[star_of_spot], error_mag)
        fits &= distance[hypothesis, spot] <= allowed_rad
        count[part] = np.bincount(hypothesis[fits], minlength=len(sky))
    return count

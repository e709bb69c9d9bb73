"""Ambiguity map: for each field, the number of other parts of the catalogue that are similar to the stars of the field.

The map contains two figures, for two types of matchers. A triangle matcher is misled by other triangles with the same
three sides. For every triangle of a field's brightest stars, the matching triangles in the catalogue are counted,
including mirror images, which distances cannot distinguish. A voting matcher is misled if wrong stars get as many votes
as the correct star. ``rivals`` is the expected number of such stars, computed from the number of stars and the number
of wrong pairs that each distance query returns. For fields with fewer than three stars both figures are infinite.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.special import gammainc

from gss.catalogue_tools.envelope.envelope import Envelope
from gss.catalogue_tools.envelope.healpix import centres
from gss.domain.angles import Array, separation_rad
from gss.domain.errors import BadInput
from gss.skytables.pairs import distance_table_of_units, expanded

BRIGHTEST = 6
BLOCK = 4096
Rows = NDArray[np.intp]


@dataclass(frozen=True)
class AmbiguityMap:
    """Figures by HEALPix ring pixel; NaN (``stars``: −1) outside the envelope.

    ``stars``: number of stars in a circle around the pixel. ``wrong_pairs``: mean number of other pairs that match a
    pair of its brightest stars. ``wrong_triangles``: mean number of other triangles that match a triangle of these
    stars. ``rivals``: expected number of wrong stars, per star, with as many votes as the correct star.
    """

    nside: int
    tolerance_rad: float
    stars: NDArray[np.int64]
    wrong_pairs: Array
    wrong_triangles: Array
    rivals: Array

    @property
    def worst(self) -> tuple[float, float, float]:
        """Right ascension, declination and ``rivals`` of the most ambiguous pixel. If ``rivals`` is infinite in several
        pixels, return the pixel with the fewest stars."""
        inside = np.flatnonzero(self.stars >= 0)
        if not len(inside):
            return float("nan"), float("nan"), float("nan")
        order = np.lexsort((self.stars[inside], -self.rivals[inside]))
        x, y, z = centres(self.nside)[inside[order[0]]]
        figure = float(self.rivals[inside[order[0]]])
        return float(np.arctan2(y, x) % (2 * np.pi)), float(np.arcsin(z)), figure

    def facts(self) -> dict[str, object]:
        """Return medians and the fraction of the envelope with fewer than three stars, for the manifest."""
        inside = self.stars >= 0
        finite = np.isfinite(self.wrong_triangles) & inside
        ra, dec, figure = self.worst
        return {
            "nside": self.nside,
            "tolerance_rad": self.tolerance_rad,
            "median_wrong_pairs": float(np.median(self.wrong_pairs[finite])) if finite.any() else None,
            "median_wrong_triangles": float(np.median(self.wrong_triangles[finite])) if finite.any() else None,
            "median_rivals": float(np.median(self.rivals[finite])) if finite.any() else None,
            "share_without_triangle": float(np.mean(~finite[inside])) if inside.any() else None,
            "worst_ra_rad": ra,
            "worst_dec_rad": dec,
            "worst_rivals": figure if np.isfinite(figure) else None,
        }


def ambiguity_map(
    unit: Array,
    envelope: Envelope,
    radius_rad: float,
    tolerance_rad: float,
    max_rad: float,
    nside: int = 16,
    brightest: int = BRIGHTEST,
) -> AmbiguityMap:
    """Compute the map of (n, 3) ICRS stars, brightest first.

    ``radius_rad``: radius of the circle that represents a field. ``tolerance_rad``: half width of the matcher's
    distance query. ``max_rad``: largest distance of the table.
    """
    if not tolerance_rad > 0 or brightest < 3 or not 0 < radius_rad < np.pi:
        raise BadInput(
            "ambiguity needs a tolerance, a field and three stars",
            expected="tolerance and radius above 0, brightest at least 3",
            got=f"{tolerance_rad:g} rad, {radius_rad:g} rad, {brightest}",
        )
    directions = centres(nside)
    inside = np.flatnonzero(envelope.contains(directions))
    stars = np.full(len(directions), -1, np.int64)
    pairs, triangles = np.full(len(directions), np.nan), np.full(len(directions), np.nan)
    if not len(inside) or not len(unit):
        stars[inside], triangles[inside] = 0, np.inf
        return AmbiguityMap(nside, tolerance_rad, stars, pairs, triangles, triangles.copy())
    near = cKDTree(unit).query_ball_point(directions[inside], 2 * np.sin(radius_rad / 2), return_sorted=True)
    stars[inside] = [len(f) for f in near]
    trios = [list(combinations(f[:brightest], 3)) for f in near]
    owner = np.repeat(inside, [len(t) for t in trios])
    triangles[inside] = np.inf
    if not len(owner):
        return AmbiguityMap(nside, tolerance_rad, stars, pairs, triangles, triangles.copy())
    all_trios = np.array([t for group in trios for t in group], np.intp)
    unique, back = np.unique(all_trios, axis=0, return_inverse=True)
    other_pairs, other_triangles = wrong_matches(unit, unique, tolerance_rad, max_rad)
    count = np.bincount(owner, minlength=len(directions))
    has_trios = count > 0
    for target, figure in ((pairs, other_pairs), (triangles, other_triangles)):
        target[has_trios] = np.bincount(owner, figure[back.ravel()], len(directions))[has_trios] / count[has_trios]
    rivals = triangles.copy()
    rivals[has_trios] = expected_rivals(np.minimum(stars[has_trios], brightest), pairs[has_trios], len(unit))
    return AmbiguityMap(nside, tolerance_rad, stars, pairs, triangles, rivals)


def expected_rivals(field_stars: NDArray[np.int64], wrong_pairs: Array, catalogue_stars: int) -> Array:
    """Return the (m,) expected number of wrong stars that get at least as many votes as the correct star. The correct
    star gets one vote from each other star of the field.

    Each wrong pair adds a vote to two stars anywhere in the catalogue, so the votes follow a Poisson distribution.
    """
    votes = field_stars - 1
    mean = votes * 2 * wrong_pairs / max(catalogue_stars, 1)
    return np.asarray(catalogue_stars * gammainc(np.maximum(votes, 1), mean))


def wrong_matches(unit: Array, trios: Rows, tolerance_rad: float, max_rad: float) -> tuple[Array, Array]:
    """Count the matches of (m, 3) triangles. Returns the (m,) mean number of other pairs with the length of a side, and
    the (m,) number of other triangles with the same three sides, within the tolerance.

    Triangles of the same stars in a different order are counted once.
    """
    table = _Neighbours(unit, max_rad + tolerance_rad)
    a, b, c = trios.T
    sides = [separation_rad(unit[i], unit[j]) for i, j in ((a, b), (a, c), (b, c))]
    pairs = sum(table.pairs_like(side, tolerance_rad) for side in sides) / 3 - 1
    wrong = np.zeros(len(trios))
    for start in range(0, len(trios), BLOCK):
        part = slice(start, start + BLOCK)
        wrong[part] = _triangles_like(unit, table, trios[part], [s[part] for s in sides], tolerance_rad)
    return np.asarray(np.maximum(pairs, 0.0)), wrong


class _Neighbours:
    """Neighbours of every star by distance, in one list sorted by star number and distance."""

    def __init__(self, unit: Array, max_rad: float) -> None:
        self.pairs = distance_table_of_units(unit, 0.0, min(max_rad, np.pi))
        first, second, distance = self.pairs.first, self.pairs.second, self.pairs.distance_rad
        sort_key = np.concatenate([first, second]) * 4.0 + np.concatenate([distance, distance])
        sort = np.argsort(sort_key)
        self.key, self.neighbour = sort_key[sort], np.concatenate([second, first])[sort]

    def pairs_like(self, side: Array, tolerance_rad: float) -> Array:
        """Return the (m,) number of pairs with each length, within the tolerance."""
        low, high = self.pairs.ranges(side - tolerance_rad, side + tolerance_rad)
        return np.asarray(high - low, float)


def _triangles_like(unit: Array, table: _Neighbours, trios: Rows, sides: list[Array], tolerance_rad: float) -> Array:
    """Return the (m,) number of other triangles that match each triangle. Pairs that match the first side are searched
    in both directions, then third stars that match the second side; then the third side is checked."""
    owner, row = expanded(*table.pairs.ranges(sides[0] - tolerance_rad, sides[0] + tolerance_rad))
    owner = np.concatenate([owner, owner])
    i = np.concatenate([table.pairs.first[row], table.pairs.second[row]])
    j = np.concatenate([table.pairs.second[row], table.pairs.first[row]])
    keys = i * 4.0 + sides[1][owner]
    ascending = np.argsort(keys)  # searchsorted is three times as fast if the keys are sorted
    keys, owner, i, j = keys[ascending], owner[ascending], i[ascending], j[ascending]
    step, at = expanded(
        np.searchsorted(table.key, keys - tolerance_rad), np.searchsorted(table.key, keys + tolerance_rad)
    )
    owner, i, j, k = owner[step], i[step], j[step], table.neighbour[at]
    like = (np.abs(separation_rad(unit[j], unit[k]) - sides[2][owner]) <= tolerance_rad) & (j != k)
    owner, triangles = owner[like], np.stack([i[like], j[like], k[like]], axis=-1)
    other = (np.sort(triangles, axis=1) != np.sort(trios[owner], axis=1)).any(axis=1)
    named = np.unique(np.column_stack([owner[other], np.sort(triangles[other], axis=1)]), axis=0)
    return np.bincount(named[:, 0], minlength=len(trios)).astype(float)

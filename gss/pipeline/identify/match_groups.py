"""Van Bezooijen's match groups as used by Sunsat (Jacobs 1995 §3.3, app. D.2).

For every pair of observed stars, the distance table gives the guide pairs with the same separation and fitting
magnitudes. A *match* is an observed star with a guide star. Two matches are joined if their pair is in the table. Each
match is the kernel of a group, and its confidence is the number of observed stars joined to it. Small groups are
dropped (limit ICLim), and large groups are split until all matches inside are joined with each other. Here, these
complete subgroups are computed as the cliques of the graph of matches. The largest group that is not a mirror image
wins. Each failure lowers ICLim by one, down to three stars.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array, cross, lengths
from gss.skytables.pairs import DistanceTable, expanded

Rows = NDArray[np.intp]
Flags = NDArray[np.bool_]
# Distances between parts of one split constellation differ by a few tolerances; those between unrelated parts of the
# sky differ by thousands.
SPLIT_TOLERANCES = 4.0


@dataclass(frozen=True)
class GroupLimits:
    """Limits of a search: tolerances of eqs. 3.1 and 3.2, smallest group size, and maximum number of splitting steps
    (``budget``)."""

    distance_rad: float
    magnitude_mag: float
    min_group: int = 3
    budget: int = 200_000


@dataclass(frozen=True)
class MatchGroup:
    """Group of k observed stars and their guide stars, (k,) each. ``misfit_rad``: sum of the differences of all
    distances, which measures the quality of a group in the document."""

    observed: Rows
    guide: Rows
    misfit_rad: float

    def __len__(self) -> int:
        return len(self.observed)


@dataclass(frozen=True)
class Grouping:
    """Result of a search. ``group``: the winner, or None with a ``reason``. ``largest``: all groups of the largest
    size, best first. ``pairs``: number of matching star pairs, ``operations``: number of table entries read and
    splitting steps."""

    group: MatchGroup | None
    largest: tuple[MatchGroup, ...]
    pairs: int
    operations: int
    reason: str


@dataclass(frozen=True)
class Guides:
    """Guide stars: (n, 3) unit vectors, (n,) magnitudes, and their distance table in float64."""

    unit: Array
    v_mag: Array
    table: DistanceTable


@dataclass(frozen=True)
class _Graph:
    """Graph of matches (observed, guide). The joins between them are stored in both directions."""

    observed: Rows
    guide: Rows
    a: Rows
    b: Rows

    def confidence(self) -> Rows:
        """Return the number of distinct observed stars joined to each match."""
        bits = np.zeros(len(self.observed), np.int64)
        np.bitwise_or.at(bits, self.a, np.int64(1) << self.observed[self.b].astype(np.int64))
        return np.bitwise_count(bits).astype(np.intp)

    def keep(self, nodes: Flags) -> _Graph:
        """Return the graph of the matches ``nodes`` only; other matches are removed from all groups (§3.3.2)."""
        number = np.cumsum(nodes) - 1
        joins = nodes[self.a] & nodes[self.b]
        return _Graph(self.observed[nodes], self.guide[nodes], number[self.a[joins]], number[self.b[joins]])


def match_groups(
    unit: Array, v_mag: Array, guides: Guides, limits: GroupLimits, allowed: Flags | None = None
) -> Grouping:
    """Find the best group for (n, 3) observed unit vectors with (n,) magnitudes. Stars with NaN are ignored. ``allowed``:
    mask of the guide stars that can be in view, None for all.

    If two largest groups do not have two matches in common, the result is ambiguous and rejected (§3.3.5), unless they
    are parts of one constellation. Among groups that agree, the group with the best quality is used. The mirror test
    uses vectors, because the right ascensions of eq. 3.3 fail at the poles.
    """
    graph, entries = _joined_matches(unit, v_mag, guides, limits, allowed)
    pairs = len(graph.a) // 2
    if not pairs:
        return Grouping(None, (), 0, entries, "no pair of stars fits a pair of the catalogue")
    spent = _Budget(limits.budget)
    size = largest_possible(graph.confidence())
    while size >= limits.min_group:
        pruned = _pruned(graph, size - 1)
        cliques = _cliques(pruned, size, spent)
        groups = [g for g in (group_of(c, unit, guides) for c in cliques) if not mirrored(g, unit, guides.unit)]
        if spent.remaining < 0:
            return Grouping(None, (), pairs, entries + limits.budget, "too many groups to split")
        if groups:
            best, reason = winner(groups, unit, guides, limits)
            return Grouping(best, ranked(groups), pairs, entries + limits.budget - spent.remaining, reason)
        size -= 1
    reason = f"no group of {limits.min_group} stars fits the catalogue"
    return Grouping(None, (), pairs, entries + limits.budget - spent.remaining, reason)


def largest_possible(confidence: Rows) -> int:
    """Return the largest n for which n groups have a confidence of at least n − 1 (§3.3.2)."""
    falling = np.sort(confidence)[::-1] + 1
    return int(np.max(np.minimum(falling, np.arange(1, len(falling) + 1)), initial=0))


def _joined_matches(
    unit: Array, v_mag: Array, guides: Guides, limits: GroupLimits, allowed: Flags | None
) -> tuple[_Graph, int]:
    n, stars, table = len(unit), len(guides.v_mag), guides.table
    bright = np.abs(v_mag[:, None] - guides.v_mag[None, :]) <= limits.magnitude_mag
    i, j = np.triu_indices(n, 1)
    apart = _angle_rad(unit[i], unit[j])
    ok = np.isfinite(apart)
    i, j, apart = i[ok], j[ok], apart[ok]
    pair, entry = expanded(*table.ranges(apart - limits.distance_rad, apart + limits.distance_rad))
    if allowed is not None:
        in_area = allowed[table.first[entry]] & allowed[table.second[entry]]
        pair, entry = pair[in_area], entry[in_area]
    i, j, first, second = i[pair], j[pair], table.first[entry].astype(np.intp), table.second[entry].astype(np.intp)
    straight, crossed = bright[i, first] & bright[j, second], bright[i, second] & bright[j, first]
    first_match = np.concatenate([i[straight] * stars + first[straight], i[crossed] * stars + second[crossed]])
    second_match = np.concatenate([j[straight] * stars + second[straight], j[crossed] * stars + first[crossed]])
    names, node = np.unique(np.concatenate([first_match, second_match]), return_inverse=True)
    a, b = node[: len(first_match)], node[len(first_match) :]
    graph = _Graph(names // max(stars, 1), names % max(stars, 1), np.concatenate([a, b]), np.concatenate([b, a]))
    return graph, len(entry)


def _angle_rad(a: Array, b: Array) -> Array:
    """Return the angle from the chord, because the arccosine of eq. C.7 loses 1e-8 rad for close stars."""
    return np.asarray(2 * np.arcsin(np.minimum(0.5 * lengths(a - b), 1.0)))


def _pruned(graph: _Graph, min_confidence: int) -> _Graph:
    """Repeatedly remove the groups with a confidence below ``min_confidence`` until all remaining groups reach it."""
    while len(graph.observed):
        strong = graph.confidence() >= min_confidence
        if strong.all():
            break
        graph = graph.keep(strong)
    return graph


@dataclass
class _Budget:
    remaining: int


def _cliques(graph: _Graph, size: int, spent: _Budget) -> list[tuple[Rows, Rows]]:
    """Return the maximal complete sets of at least ``size`` matches (Bron and Kerbosch with pivot), in a fixed order."""
    joined: list[set[int]] = [set() for _ in graph.observed]
    for a, b in zip(graph.a.tolist(), graph.b.tolist(), strict=True):
        joined[a].add(b)
    cliques: list[list[int]] = []

    def grow(chosen: list[int], open_: set[int], excluded: set[int]) -> None:
        spent.remaining -= 1
        if spent.remaining < 0 or len(chosen) + len(open_) < size:
            return
        if not open_:
            if not excluded:
                cliques.append(sorted(chosen))
            return
        pivot = max(sorted(open_ | excluded), key=lambda k: len(joined[k] & open_))
        for k in sorted(open_ - joined[pivot]):
            grow([*chosen, k], open_ & joined[k], excluded & joined[k])
            open_, excluded = open_ - {k}, excluded | {k}

    grow([], set(range(len(joined))), set())
    return [(graph.observed[c], graph.guide[c]) for c in sorted(cliques)]


def group_of(match: tuple[Rows, Rows], unit: Array, guides: Guides) -> MatchGroup:
    """Return a set of matches as a group with its quality."""
    observed, guide = match
    i, j = np.triu_indices(len(observed), 1)
    angle_rad = _angle_rad(unit[observed[i]], unit[observed[j]])
    reference_rad = _angle_rad(guides.unit[guide[i]], guides.unit[guide[j]])
    return MatchGroup(observed, guide, float(np.sum(np.abs(angle_rad - reference_rad))))


def mirrored(group: MatchGroup, unit: Array, guide_unit: Array) -> bool:
    """True if the observed stars are the mirror image of the guide stars (§3.3.3), tested on the largest triangle at the kernel."""
    o, g = unit[group.observed], guide_unit[group.guide]
    i, j = np.triu_indices(len(o) - 1, 1)
    handedness = np.einsum("ij,ij->i", cross(o[1 + i], o[1 + j]), np.broadcast_to(o[0], (len(i), 3)))
    reference = np.einsum("ij,ij->i", cross(g[1 + i], g[1 + j]), np.broadcast_to(g[0], (len(i), 3)))
    widest = int(np.argmax(np.abs(reference)))
    return bool(handedness[widest] * reference[widest] < 0)


def ranked(groups: list[MatchGroup]) -> tuple[MatchGroup, ...]:
    """Return the largest groups, best quality first."""
    largest = max(len(g) for g in groups)
    return tuple(sorted((g for g in groups if len(g) == largest), key=lambda g: g.misfit_rad))


def winner(groups: list[MatchGroup], unit: Array, guides: Guides, limits: GroupLimits) -> tuple[MatchGroup | None, str]:
    """Return the best of the largest groups, or None and the reason if the result is ambiguous."""
    largest = ranked(groups)
    best = largest[0]
    if all(_one_answer(best, other, unit, guides, limits) for other in largest[1:]):
        return best, ""
    return None, f"{len(largest)} different groups of {len(best)} stars fit the catalogue"


def _one_answer(group: MatchGroup, other: MatchGroup, unit: Array, guides: Guides, limits: GroupLimits) -> bool:
    """True if both groups agree: they have two matches in common (§3.3.5), or all distances between the two groups are
    nearly right. Stars with a large error can split a constellation into parts that share fewer than two matches."""
    first = dict(zip(group.observed.tolist(), group.guide.tolist(), strict=True))
    if sum(first.get(o) == g for o, g in zip(other.observed.tolist(), other.guide.tolist(), strict=True)) > 1:
        return True
    angle_rad = _angle_rad(unit[group.observed][:, None], unit[other.observed][None])
    reference_rad = _angle_rad(guides.unit[group.guide][:, None], guides.unit[other.guide][None])
    return bool(np.all(np.abs(angle_rad - reference_rad) <= SPLIT_TOLERANCES * limits.distance_rad))

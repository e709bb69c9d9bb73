"""Geometric voting, compared with a literal implementation of Algorithm 2."""

from __future__ import annotations

import numpy as np

from gss.domain.angles import Array, separation_rad
from gss.domain.rotation import matrix_from_quaternion, random_quaternion
from gss.pipeline.identify.geometric_voting import (
    agreement,
    cluster,
    mutually_consistent,
    pairs_of,
    reduced_table,
    vote,
)
from gss.skytables.bank import OnboardCatalogue
from gss.skytables.pairs import DistanceTable

TOLERANCE_RAD = 2e-3


def _random_catalogue(rng: np.random.Generator, n: int) -> OnboardCatalogue:
    """Return ``n`` stars over the whole sky and all their pairs up to 1 rad, as float32."""
    icrs = rng.normal(size=(n, 3))
    icrs /= np.linalg.norm(icrs, axis=1, keepdims=True)
    i, j = np.triu_indices(n, 1)
    distance_rad = separation_rad(icrs[i], icrs[j])
    order = np.flatnonzero(distance_rad <= 1.0)
    order = order[np.argsort(distance_rad[order])]
    table = DistanceTable(
        i[order].astype(np.int32), j[order].astype(np.int32), distance_rad[order].astype(np.float32), 0.0, 1.0
    )
    return OnboardCatalogue(np.arange(n, dtype=np.int32), icrs.astype(np.float32), np.full(n, np.nan), table)


def _literal(unit: Array, catalogue: OnboardCatalogue, e: float) -> tuple[list[list[int]], list[int], list[int]]:
    """Erlank 2013 Algorithm 2 line by line, with a linear search. Returns voting lists, identified rows and
    verification votes.
    """
    n, t = len(unit), catalogue.distances
    lists = [[0] * len(catalogue) for _ in range(n)]
    for i in range(n - 1):
        for j in range(i + 1, n):
            d = float(separation_rad(unit[i], unit[j]))
            for k in range(len(t)):
                if d - e <= float(t.distance_rad[k]) <= d + e:
                    for star in (i, j):
                        lists[star][t.first[k]] += 1
                        lists[star][t.second[k]] += 1
    rows = [row.index(max(row)) if max(row) else -1 for row in lists]
    votes = [0] * n
    for i in range(n - 1):
        for j in range(i + 1, n):
            if min(rows[i], rows[j]) < 0 or rows[i] == rows[j]:
                continue
            a, b = catalogue.icrs[rows[i]].astype(float), catalogue.icrs[rows[j]].astype(float)
            if abs(float(separation_rad(a, b)) - float(separation_rad(unit[i], unit[j]))) <= e:
                votes[i] += 1
                votes[j] += 1
    return lists, rows, votes


def test_votes_agree_with_the_printed_algorithm() -> None:
    """The identified rows, the first votes and the verification votes equal those of the literal Algorithm 2, for true
    and false stars.
    """
    rng = np.random.default_rng(21)
    for _ in range(12):
        catalogue = _random_catalogue(rng, 45)
        rotation = matrix_from_quaternion(random_quaternion(rng))
        cam = catalogue.icrs.astype(float) @ rotation.T
        visible = cam[np.argsort(-cam[:, 2])[:6]]
        false_stars = np.column_stack([rng.uniform(-0.5, 0.5, (3, 2)), np.ones(3)])
        unit = np.vstack([visible, false_stars / np.linalg.norm(false_stars, axis=1, keepdims=True)])
        lists, rows, votes = _literal(unit, catalogue, TOLERANCE_RAD)
        pairs = pairs_of(unit)
        ballot = vote(pairs, len(unit), catalogue.distances, len(catalogue), TOLERANCE_RAD)
        assert ballot.row.tolist() == rows
        assert ballot.votes.tolist() == [max(row) for row in lists]
        assert ballot.hits * 4 == sum(map(sum, lists))
        assert agreement(pairs, ballot.row, catalogue, TOLERANCE_RAD).sum(axis=1).tolist() == votes


def test_reduced_table_needs_both_stars() -> None:
    """A pair is kept only if both of its stars are allowed, and the order by distance is preserved."""
    catalogue = _random_catalogue(np.random.default_rng(22), 30)
    allowed = np.arange(30) % 3 > 0
    table = reduced_table(catalogue.distances, allowed)
    t = catalogue.distances
    expected = [k for k in range(len(t)) if allowed[t.first[k]] and allowed[t.second[k]]]
    np.testing.assert_array_equal(table.distance_rad, t.distance_rad[expected])
    np.testing.assert_array_equal(table.second, t.second[expected])


def test_too_few_stars_give_no_match() -> None:
    """No stars, one star, an empty table and an empty catalogue give no matches."""
    catalogue = _random_catalogue(np.random.default_rng(23), 20)
    empty_table = reduced_table(catalogue.distances, np.zeros(20, bool))
    two_stars = np.array([[0, 0, 1.0], [0, 0.1, np.sqrt(0.99)]])
    assert vote(pairs_of(np.empty((0, 3))), 0, catalogue.distances, 20, 1e-3).row.tolist() == []
    assert vote(pairs_of(two_stars[:1]), 1, catalogue.distances, 20, 1e-3).row.tolist() == [-1]
    assert vote(pairs_of(two_stars), 2, empty_table, 20, 1e-3).row.tolist() == [-1, -1]
    assert vote(pairs_of(two_stars), 2, empty_table, 0, 1e-3).row.tolist() == [-1, -1]


def test_equal_votes_go_to_the_lower_row() -> None:
    """Two stars alone are ambiguous: both get the lower row, and the duplicate match is rejected."""
    catalogue = _random_catalogue(np.random.default_rng(24), 20)
    t = catalogue.distances
    a, b = int(t.first[0]), int(t.second[0])
    unit = catalogue.icrs[[a, b]].astype(float)
    pairs = pairs_of(unit)
    ballot = vote(pairs, 2, t, 20, 1e-6)
    assert ballot.row.tolist() == [min(a, b)] * 2
    assert agreement(pairs, ballot.row, catalogue, 1.0).sum() == 0


def test_cluster_includes_votes_within_the_margin() -> None:
    """By Kolomenkin's rule, stars with at most ``margin`` votes less than the maximum are included, but no star without
    a vote.
    """
    assert cluster(np.array([7, 6, 5, 1, 0]), 1).tolist() == [0, 1]
    assert cluster(np.array([1, 1, 0]), 1).tolist() == [0, 1]
    assert cluster(np.zeros(3, int), 1).tolist() == []
    assert cluster(np.zeros(0, int), 1).tolist() == []


def test_inconsistent_stars_are_excluded() -> None:
    """Of four mutually consistent stars and a fifth that agrees with only two of them, the four are kept. Of
    inconsistent stars, one is kept.
    """
    agree = np.ones((5, 5), np.int64) - np.eye(5, dtype=np.int64)
    agree[4, :2] = agree[:2, 4] = 0
    assert mutually_consistent(agree, np.arange(5)).tolist() == [0, 1, 2, 3]
    assert len(mutually_consistent(np.zeros((3, 3), np.int64), np.arange(3))) == 1

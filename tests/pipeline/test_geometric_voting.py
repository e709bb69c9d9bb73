"""Geometric voting against Algorithm 2 written out."""

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
    """n stars all over the sky and all their pairs up to 1 rad, as float32."""
    icrs = rng.normal(size=(n, 3))
    icrs /= np.linalg.norm(icrs, axis=1, keepdims=True)
    i, j = np.triu_indices(n, 1)
    d = separation_rad(icrs[i], icrs[j])
    keep = np.flatnonzero(d <= 1.0)
    keep = keep[np.argsort(d[keep])]
    table = DistanceTable(i[keep].astype(np.int32), j[keep].astype(np.int32), d[keep].astype(np.float32), 0.0, 1.0)
    return OnboardCatalogue(np.arange(n, dtype=np.int32), icrs.astype(np.float32), np.full(n, np.nan), table)


def _literal(unit: Array, catalogue: OnboardCatalogue, e: float) -> tuple[list[list[int]], list[int], list[int]]:
    """Erlank 2013 Algorithm 2 line by line, with a linear search: voting lists, names and verification votes."""
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
    names = [row.index(max(row)) if max(row) else -1 for row in lists]
    votes = [0] * n
    for i in range(n - 1):
        for j in range(i + 1, n):
            if min(names[i], names[j]) < 0 or names[i] == names[j]:
                continue
            a, b = catalogue.icrs[names[i]].astype(float), catalogue.icrs[names[j]].astype(float)
            if abs(float(separation_rad(a, b)) - float(separation_rad(unit[i], unit[j]))) <= e:
                votes[i] += 1
                votes[j] += 1
    return lists, names, votes


def test_votes_are_those_of_the_printed_algorithm() -> None:
    """First-round names and counts and verification votes equal a literal Algorithm 2 on mixed true and false stars."""
    rng = np.random.default_rng(21)
    for _ in range(12):
        catalogue = _random_catalogue(rng, 45)
        rotation = matrix_from_quaternion(random_quaternion(rng))
        cam = catalogue.icrs.astype(float) @ rotation.T
        seen = cam[np.argsort(-cam[:, 2])[:6]]
        false = np.column_stack([rng.uniform(-0.5, 0.5, (3, 2)), np.ones(3)])
        unit = np.vstack([seen, false / np.linalg.norm(false, axis=1, keepdims=True)])
        lists, names, votes = _literal(unit, catalogue, TOLERANCE_RAD)
        pairs = pairs_of(unit)
        ballot = vote(pairs, len(unit), catalogue.distances, len(catalogue), TOLERANCE_RAD)
        assert ballot.row.tolist() == names
        assert ballot.votes.tolist() == [max(row) for row in lists]
        assert ballot.hits * 4 == sum(map(sum, lists))
        assert agreement(pairs, ballot.row, catalogue, TOLERANCE_RAD).sum(axis=1).tolist() == votes


def test_reduced_table_needs_both_stars() -> None:
    """A pair stays only where both of its stars are allowed, and the order by distance stays."""
    catalogue = _random_catalogue(np.random.default_rng(22), 30)
    allowed = np.arange(30) % 3 > 0
    table = reduced_table(catalogue.distances, allowed)
    t = catalogue.distances
    expected = [k for k in range(len(t)) if allowed[t.first[k]] and allowed[t.second[k]]]
    np.testing.assert_array_equal(table.distance_rad, t.distance_rad[expected])
    np.testing.assert_array_equal(table.second, t.second[expected])


def test_too_few_stars_give_no_match() -> None:
    """No stars, one star, an empty table and an empty catalogue end without matches."""
    catalogue = _random_catalogue(np.random.default_rng(23), 20)
    none = reduced_table(catalogue.distances, np.zeros(20, bool))
    two = np.array([[0, 0, 1.0], [0, 0.1, np.sqrt(0.99)]])
    assert vote(pairs_of(np.empty((0, 3))), 0, catalogue.distances, 20, 1e-3).row.tolist() == []
    assert vote(pairs_of(two[:1]), 1, catalogue.distances, 20, 1e-3).row.tolist() == [-1]
    assert vote(pairs_of(two), 2, none, 20, 1e-3).row.tolist() == [-1, -1]
    assert vote(pairs_of(two), 2, none, 0, 1e-3).row.tolist() == [-1, -1]


def test_equal_votes_go_to_the_lower_row() -> None:
    """Two stars alone are ambiguous: both get the lower number, and a duplicate match is rejected."""
    catalogue = _random_catalogue(np.random.default_rng(24), 20)
    t = catalogue.distances
    a, b = int(t.first[0]), int(t.second[0])
    unit = catalogue.icrs[[a, b]].astype(float)
    pairs = pairs_of(unit)
    ballot = vote(pairs, 2, t, 20, 1e-6)
    assert ballot.row.tolist() == [min(a, b)] * 2
    assert agreement(pairs, ballot.row, catalogue, 1.0).sum() == 0


def test_cluster_takes_votes_within_the_margin() -> None:
    """Kolomenkin's rule: at most ``margin`` below the most, and never a star without a vote."""
    assert cluster(np.array([7, 6, 5, 1, 0]), 1).tolist() == [0, 1]
    assert cluster(np.array([1, 1, 0]), 1).tolist() == [0, 1]
    assert cluster(np.zeros(3, int), 1).tolist() == []
    assert cluster(np.zeros(0, int), 1).tolist() == []


def test_a_star_that_disagrees_is_left_out() -> None:
    """Of four friends and one who agrees with two of them, the four stay; of strangers, one."""
    agree = np.ones((5, 5), np.int64) - np.eye(5, dtype=np.int64)
    agree[4, :2] = agree[:2, 4] = 0
    assert mutually_consistent(agree, np.arange(5)).tolist() == [0, 1, 2, 3]
    assert len(mutually_consistent(np.zeros((3, 3), np.int64), np.arange(3))) == 1

"""Match groups and star vectors: worked examples, false stars, mirror images, ambiguity and the search budget."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest

from gss.domain.angles import Array
from gss.domain.rotation import matrix_from_quaternion, random_quaternion
from gss.pipeline.identify.match_groups import (
    Grouping,
    GroupLimits,
    Guides,
    largest_possible,
    match_groups,
)
from gss.pipeline.identify.star_vectors import match_star_vectors
from gss.skytables.pairs import distance_table_of_units

LIMITS = GroupLimits(1e-4, 0.5)


def _sky(seed: int, n: int = 400, spread: float = 0.25) -> Guides:
    """Return random stars of magnitude 3 to 6 within a part of the sky, and their distance table."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-spread, spread, (n, 2))
    unit = np.column_stack([xy, np.ones(n)])
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    return Guides(unit, rng.uniform(3, 6, n), distance_table_of_units(unit, 0.004, 0.24))


def _observed(guides: Guides, rows: Array, seed: int = 0) -> tuple[Array, Array]:
    """Return these stars as seen by a camera with a random attitude."""
    turn = matrix_from_quaternion(random_quaternion(np.random.default_rng(seed)))
    return guides.unit[rows] @ turn.T, guides.v_mag[rows] + 0.1


def _field(guides: Guides, count: int, seed: int = 1) -> Array:
    """Return the rows of stars near each other, as in a field of view."""
    centre = guides.unit[np.random.default_rng(seed).integers(len(guides.unit))]
    return np.argsort(np.linalg.norm(guides.unit - centre, axis=1))[: 3 * count : 3]


def _solve(method: str, unit: Array, v_mag: Array, guides: Guides, limits: GroupLimits = LIMITS) -> Grouping:
    """Match the stars with one of the two methods."""
    if method == "star_vectors":
        return match_star_vectors(unit, v_mag, guides, np.ones(len(guides.v_mag), bool), limits)
    return match_groups(unit, v_mag, guides, limits)


def _matches(grouping: Grouping) -> dict[int, int]:
    """Return the matched guide star of each observed star."""
    assert grouping.group is not None, grouping.reason
    return dict(zip(grouping.group.observed.tolist(), grouping.group.guide.tolist(), strict=True))


@pytest.mark.parametrize("method", ["match_groups", "star_vectors"])
@pytest.mark.parametrize("seed", range(8))
def test_eight_true_stars_are_identified(method: str, seed: int) -> None:
    """Both methods identify all eight stars of a field, at any attitude."""
    guides = _sky(seed)
    rows = _field(guides, 8, seed)
    assert _matches(_solve(method, *_observed(guides, rows, seed), guides)) == dict(enumerate(rows.tolist()))


@pytest.mark.parametrize("false_count", [1, 2, 3, 4])
def test_match_groups_tolerate_false_stars(false_count: int) -> None:
    """If up to half of the eight stars are false, the true ones are identified and no false one is (§3.2.1)."""
    guides = _sky(20)
    rows = _field(guides, 8)
    unit, v_mag = _observed(guides, rows)
    rng = np.random.default_rng(false_count)
    unit[:false_count] += rng.normal(0, 0.05, (false_count, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    assert _matches(match_groups(unit, v_mag, guides, LIMITS)) == {k: int(rows[k]) for k in range(false_count, 8)}


def test_one_false_star_prevents_a_match_of_star_vectors() -> None:
    """One false star prevents the match of star vectors, and the reason is stated (§3.2.2, their main drawback)."""
    guides = _sky(20)
    unit, v_mag = _observed(guides, _field(guides, 8))
    unit[3] = unit[3] + [0.01, 0, 0]
    unit[3] /= np.linalg.norm(unit[3])
    result = _solve("star_vectors", unit, v_mag, guides)
    assert result.group is None
    assert result.reason == "no constellation of all 8 stars fits the catalogue"


@pytest.mark.parametrize("method", ["match_groups", "star_vectors"])
def test_mirror_images_are_rejected(method: str) -> None:
    """The same distances in mirrored order give no match (§3.3.3)."""
    guides = _sky(5)
    unit, v_mag = _observed(guides, _field(guides, 8))
    assert _solve(method, unit * [1, 1, -1], v_mag, guides).group is None


@pytest.mark.parametrize("method", ["match_groups", "star_vectors"])
def test_magnitudes_must_fit(method: str) -> None:
    """With a tolerance of 0.5 mag, a star wrong by 0.6 mag is excluded from match groups, and prevents a match of star
    vectors.
    """
    guides = _sky(6)
    rows = _field(guides, 8)
    unit, v_mag = _observed(guides, rows)
    v_mag[2] += 0.6
    result = _solve(method, unit, v_mag, guides)
    if method == "match_groups":
        assert _matches(result) == {k: int(w) for k, w in enumerate(rows) if k != 2}
    else:
        assert result.group is None


def test_order_of_stars_has_no_effect() -> None:
    """The observed stars in any order give the same matches."""
    guides = _sky(7)
    rows = _field(guides, 7)
    unit, v_mag = _observed(guides, rows)
    for seed in range(6):
        order = np.random.default_rng(seed).permutation(7)
        matches = _matches(match_groups(unit[order], v_mag[order], guides, LIMITS))
        assert matches == {k: int(rows[o]) for k, o in enumerate(order)}


def test_an_inaccurate_distance_splits_the_group() -> None:
    """If the distance between two stars is wrong, two groups remain, and the one with the smaller misfit is used
    (§3.3.3, Table 3-4).
    """
    guides = _sky(8)
    rows = _field(guides, 6)
    unit, v_mag = _observed(guides, rows)
    difference = unit[1] - unit[0]
    unit[0] -= 0.8e-4 * difference / np.linalg.norm(difference)
    unit[1] += 0.8e-4 * difference / np.linalg.norm(difference)
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    result = match_groups(unit, v_mag, guides, LIMITS)
    matches = _matches(result)
    assert len(matches) == 5
    assert matches.items() <= dict(enumerate(rows.tolist())).items()
    assert len(result.largest) == 2
    assert result.largest[0].misfit_rad <= result.largest[1].misfit_rad


def test_parts_of_a_split_constellation_are_consistent() -> None:
    """If two groups of three stars share no star but their relative position is correct within a few tolerances, they
    are not contradictory, and a match is returned.
    """
    guides = _sky(14)
    rows = _field(guides, 6)
    unit, v_mag = _observed(guides, rows)
    # Move one half by two and a half tolerances.
    middle = unit.mean(axis=0)
    sideways = np.cross(middle, unit[0] - middle)
    unit[3:] += 2.5e-4 * sideways / np.linalg.norm(sideways)
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    result = match_groups(unit, v_mag, guides, LIMITS)
    matches = _matches(result)
    assert matches.items() <= dict(enumerate(rows.tolist())).items()
    assert len(result.largest) > 1


def test_contradictory_matches_give_none() -> None:
    """A catalogue that contains the same constellation twice gives no match, and the reason states that there are two."""
    guides = _sky(9, 60, 0.1)
    rows = _field(guides, 5)
    turn = matrix_from_quaternion(random_quaternion(np.random.default_rng(3)))
    combined = np.vstack([guides.unit, guides.unit @ turn.T])
    twice = Guides(combined, np.tile(guides.v_mag, 2), distance_table_of_units(combined, 0.004, 0.24))
    result = match_groups(*_observed(guides, rows), twice, LIMITS)
    assert result.group is None
    assert len(result.largest) == 2
    assert result.reason == "2 different groups of 5 stars fit the catalogue"


@pytest.mark.parametrize("method", ["match_groups", "star_vectors"])
@pytest.mark.parametrize("n", [0, 1, 2])
def test_fewer_than_three_stars_give_no_group(method: str, n: int) -> None:
    """Fewer than three stars give no group and a reason."""
    guides = _sky(10)
    unit, v_mag = _observed(guides, _field(guides, 4))
    result = _solve(method, unit[:n], v_mag[:n], guides)
    assert result.group is None
    assert result.reason


def test_stars_with_nan_are_ignored() -> None:
    """A star without direction or magnitude is ignored, and the others are identified."""
    guides = _sky(11)
    rows = _field(guides, 8)
    unit, v_mag = _observed(guides, rows)
    unit[1], v_mag[4] = np.nan, np.nan
    assert _matches(match_groups(unit, v_mag, guides, LIMITS)) == {
        k: int(w) for k, w in enumerate(rows) if k not in (1, 4)
    }


def test_an_exhausted_budget_gives_no_match() -> None:
    """With a budget of one step, the search ends without a group and states why. The number of operations is
    reproducible.
    """
    guides = _sky(12)
    unit, v_mag = _observed(guides, _field(guides, 8))
    for method in ("match_groups", "star_vectors"):
        result = _solve(method, unit, v_mag, guides, replace(LIMITS, budget=1))
        assert result.group is None
        assert "too many" in result.reason
    first, second = (match_groups(unit, v_mag, guides, LIMITS) for _ in range(2))
    assert first.operations == second.operations


def test_groups_agree_with_a_brute_force_search() -> None:
    """Every group has all four stars and fits in distance and magnitude. A brute-force search over all sets of matches
    finds at least as many, because it includes mirrored ones.
    """
    guides = _sky(13, 60, 0.12)
    wide = GroupLimits(8e-3, 1.5)
    unit, v_mag = _observed(guides, _field(guides, 4))
    result = match_groups(unit, v_mag, guides, wide)
    assert result.largest
    size = len(result.largest[0])

    def fits(observed: tuple[int, ...], guide: tuple[int, ...]) -> bool:
        if any(abs(v_mag[a] - guides.v_mag[b]) > 1.5 for a, b in zip(observed, guide, strict=True)):
            return False
        i, j = np.triu_indices(len(observed), 1)
        observed_unit, guide_unit = unit[list(observed)], guides.unit[list(guide)]
        observed_rad = 2 * np.arcsin(np.linalg.norm(observed_unit[i] - observed_unit[j], axis=1) / 2)
        guide_rad = 2 * np.arcsin(np.linalg.norm(guide_unit[i] - guide_unit[j], axis=1) / 2)
        in_table = (guide_rad >= guides.table.min_rad) & (guide_rad <= guides.table.max_rad)
        return bool(np.all((np.abs(observed_rad - guide_rad) <= 8e-3) & in_table))

    assert size == 4
    for group in result.largest:
        assert fits(tuple(group.observed.tolist()), tuple(group.guide.tolist()))
    brute_force = 0
    candidates = [np.flatnonzero(np.abs(v_mag[k] - guides.v_mag) <= 1.5) for k in range(4)]
    for a, b in itertools.product(candidates[0].tolist(), candidates[1].tolist()):
        if a == b or not fits((0, 1), (a, b)):
            continue
        for c in candidates[2].tolist():
            if c in (a, b) or not fits((0, 1, 2), (a, b, c)):
                continue
            brute_force += sum(d not in (a, b, c) and fits((0, 1, 2, 3), (a, b, c, d)) for d in candidates[3].tolist())
    mirrored = brute_force - len(result.largest)
    assert mirrored >= 0
    assert len(result.largest) >= 1


def test_size_estimate_agrees_with_the_document() -> None:
    """A constellation of n stars needs n groups of confidence n − 1 (§3.3.2)."""
    assert largest_possible(np.array([5, 3, 3, 3])) == 4
    assert largest_possible(np.array([7, 7, 1, 1])) == 2
    assert largest_possible(np.array([], int)) == 0

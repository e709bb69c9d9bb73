"""Match groups and star vectors: worked examples, false stars, mirror images, ambiguity, and the budget."""

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
    """Random stars within a patch, magnitudes 3 to 6, and their table."""
    rng = np.random.default_rng(seed)
    xy = rng.uniform(-spread, spread, (n, 2))
    unit = np.column_stack([xy, np.ones(n)])
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    return Guides(unit, rng.uniform(3, 6, n), distance_table_of_units(unit, 0.004, 0.24))


def _observed(guides: Guides, who: Array, seed: int = 0) -> tuple[Array, Array]:
    """Those stars in a camera turned at random."""
    turn = matrix_from_quaternion(random_quaternion(np.random.default_rng(seed)))
    return guides.unit[who] @ turn.T, guides.v_mag[who] + 0.1


def _field(guides: Guides, count: int, seed: int = 1) -> Array:
    """Stars near one another, as a field of view has them."""
    centre = guides.unit[np.random.default_rng(seed).integers(len(guides.unit))]
    return np.argsort(np.linalg.norm(guides.unit - centre, axis=1))[: 3 * count : 3]


def _solve(way: str, unit: Array, v_mag: Array, guides: Guides, limits: GroupLimits = LIMITS) -> Grouping:
    if way == "star_vectors":
        return match_star_vectors(unit, v_mag, guides, np.ones(len(guides.v_mag), bool), limits)
    return match_groups(unit, v_mag, guides, limits)


def _names(grouping: Grouping) -> dict[int, int]:
    assert grouping.group is not None, grouping.reason
    return dict(zip(grouping.group.observed.tolist(), grouping.group.guide.tolist(), strict=True))


@pytest.mark.parametrize("way", ["match_groups", "star_vectors"])
@pytest.mark.parametrize("seed", range(8))
def test_eight_true_stars_are_named(way: str, seed: int) -> None:
    """Both ways name all eight stars of a field, in any attitude."""
    guides = _sky(seed)
    who = _field(guides, 8, seed)
    assert _names(_solve(way, *_observed(guides, who, seed), guides)) == dict(enumerate(who.tolist()))


@pytest.mark.parametrize("false", [1, 2, 3, 4])
def test_false_stars_do_not_disturb_match_groups(false: int) -> None:
    """§3.2.1: with up to half of the eight stars false the true ones are still named, and no false one is."""
    guides = _sky(20)
    who = _field(guides, 8)
    unit, v_mag = _observed(guides, who)
    rng = np.random.default_rng(false)
    unit[:false] += rng.normal(0, 0.05, (false, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    assert _names(match_groups(unit, v_mag, guides, LIMITS)) == {k: int(who[k]) for k in range(false, 8)}


def test_one_false_star_ruins_star_vectors() -> None:
    """§3.2.2: the main drawback: one false star prevents the match, and the reason is stated."""
    guides = _sky(20)
    unit, v_mag = _observed(guides, _field(guides, 8))
    unit[3] = unit[3] + [0.01, 0, 0]
    unit[3] /= np.linalg.norm(unit[3])
    answer = _solve("star_vectors", unit, v_mag, guides)
    assert answer.group is None
    assert answer.reason == "no constellation of all 8 stars fits the catalogue"


@pytest.mark.parametrize("way", ["match_groups", "star_vectors"])
def test_mirror_images_are_rejected(way: str) -> None:
    """§3.3.3: the same distances in mirrored order give no match."""
    guides = _sky(5)
    unit, v_mag = _observed(guides, _field(guides, 8))
    assert _solve(way, unit * [1, 1, -1], v_mag, guides).group is None


@pytest.mark.parametrize("way", ["match_groups", "star_vectors"])
def test_magnitudes_must_fit(way: str) -> None:
    """A star 0.6 mag off with a tolerance of 0.5 is not matched: it leaves the group and the star vectors."""
    guides = _sky(6)
    who = _field(guides, 8)
    unit, v_mag = _observed(guides, who)
    v_mag[2] += 0.6
    answer = _solve(way, unit, v_mag, guides)
    if way == "match_groups":
        assert _names(answer) == {k: int(w) for k, w in enumerate(who) if k != 2}
    else:
        assert answer.group is None


def test_order_of_stars_does_not_matter() -> None:
    """Any order of the observed stars gives the same names."""
    guides = _sky(7)
    who = _field(guides, 7)
    unit, v_mag = _observed(guides, who)
    for seed in range(6):
        order = np.random.default_rng(seed).permutation(7)
        names = _names(match_groups(unit[order], v_mag[order], guides, LIMITS))
        assert names == {k: int(who[o]) for k, o in enumerate(order)}


def test_a_high_sigma_star_splits_the_group() -> None:
    """§3.3.3, Table 3-4: a star whose distance to one other is off leaves two groups; the better one of the two counts."""
    guides = _sky(8)
    who = _field(guides, 6)
    unit, v_mag = _observed(guides, who)
    away = unit[1] - unit[0]
    unit[0] -= 0.8e-4 * away / np.linalg.norm(away)
    unit[1] += 0.8e-4 * away / np.linalg.norm(away)
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    answer = match_groups(unit, v_mag, guides, LIMITS)
    names = _names(answer)
    assert len(names) == 5
    assert names.items() <= dict(enumerate(who.tolist())).items()
    assert len(answer.largest) == 2
    assert answer.largest[0].misfit_rad <= answer.largest[1].misfit_rad


def test_parts_of_a_split_constellation_are_one_answer() -> None:
    """Two groups of three that share no star but lie rightly to one another within a few tolerances are one answer."""
    guides = _sky(14)
    who = _field(guides, 6)
    unit, v_mag = _observed(guides, who)
    # Pull the halves apart by two tolerances.
    middle = unit.mean(axis=0)
    away = np.cross(middle, unit[0] - middle)
    unit[3:] += 2.5e-4 * away / np.linalg.norm(away)
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    answer = match_groups(unit, v_mag, guides, LIMITS)
    names = _names(answer)
    assert names.items() <= dict(enumerate(who.tolist())).items()
    assert len(answer.largest) > 1


def test_two_different_answers_are_none() -> None:
    """A catalogue that holds the same constellation twice gives no answer, and says there are two."""
    guides = _sky(9, 60, 0.1)
    who = _field(guides, 5)
    turn = matrix_from_quaternion(random_quaternion(np.random.default_rng(3)))
    both = np.vstack([guides.unit, guides.unit @ turn.T])
    twice = Guides(both, np.tile(guides.v_mag, 2), distance_table_of_units(both, 0.004, 0.24))
    answer = match_groups(*_observed(guides, who), twice, LIMITS)
    assert answer.group is None
    assert len(answer.largest) == 2
    assert answer.reason == "2 different groups of 5 stars fit the catalogue"


@pytest.mark.parametrize("way", ["match_groups", "star_vectors"])
@pytest.mark.parametrize("n", [0, 1, 2])
def test_fewer_than_three_stars_are_not_a_group(way: str, n: int) -> None:
    """ICLim ends at one: nothing below three stars."""
    guides = _sky(10)
    unit, v_mag = _observed(guides, _field(guides, 4))
    answer = _solve(way, unit[:n], v_mag[:n], guides)
    assert answer.group is None
    assert answer.reason


def test_unknown_directions_take_no_part() -> None:
    """A star without a direction or a magnitude is left out, the others are named."""
    guides = _sky(11)
    who = _field(guides, 8)
    unit, v_mag = _observed(guides, who)
    unit[1], v_mag[4] = np.nan, np.nan
    assert _names(match_groups(unit, v_mag, guides, LIMITS)) == {
        k: int(w) for k, w in enumerate(who) if k not in (1, 4)
    }


def test_an_exhausted_budget_gives_no_answer() -> None:
    """With a budget of one step the search ends without a group and says why; the count is the same every time."""
    guides = _sky(12)
    unit, v_mag = _observed(guides, _field(guides, 8))
    for way in ("match_groups", "star_vectors"):
        answer = _solve(way, unit, v_mag, guides, replace(LIMITS, budget=1))
        assert answer.group is None
        assert "too many" in answer.reason
    first, second = (match_groups(unit, v_mag, guides, LIMITS) for _ in range(2))
    assert first.operations == second.operations


def test_groups_are_complete_and_largest() -> None:
    """Against a plain search over all sets of matches: no larger set exists in which every distance and magnitude fits."""
    guides = _sky(13, 60, 0.12)
    wide = GroupLimits(8e-3, 1.5)
    unit, v_mag = _observed(guides, _field(guides, 4))
    answer = match_groups(unit, v_mag, guides, wide)
    assert answer.largest
    size = len(answer.largest[0])

    def fits(o: tuple[int, ...], g: tuple[int, ...]) -> bool:
        if any(abs(v_mag[a] - guides.v_mag[b]) > 1.5 for a, b in zip(o, g, strict=True)):
            return False
        i, j = np.triu_indices(len(o), 1)
        oo, gg = unit[list(o)], guides.unit[list(g)]
        seen = 2 * np.arcsin(np.linalg.norm(oo[i] - oo[j], axis=1) / 2)
        known = 2 * np.arcsin(np.linalg.norm(gg[i] - gg[j], axis=1) / 2)
        in_table = (known >= guides.table.min_rad) & (known <= guides.table.max_rad)
        return bool(np.all((np.abs(seen - known) <= 8e-3) & in_table))

    assert size == 4
    for group in answer.largest:
        assert fits(tuple(group.observed.tolist()), tuple(group.guide.tolist()))
    by_hand = 0
    near = [np.flatnonzero(np.abs(v_mag[k] - guides.v_mag) <= 1.5) for k in range(4)]
    for a, b in itertools.product(near[0].tolist(), near[1].tolist()):
        if a == b or not fits((0, 1), (a, b)):
            continue
        for c in near[2].tolist():
            if c in (a, b) or not fits((0, 1, 2), (a, b, c)):
                continue
            by_hand += sum(d not in (a, b, c) and fits((0, 1, 2, 3), (a, b, c, d)) for d in near[3].tolist())
    mirrored_too = by_hand - len(answer.largest)
    assert mirrored_too >= 0
    assert len(answer.largest) >= 1


def test_size_estimate_is_the_documents() -> None:
    """§3.3.2: n groups of confidence n − 1 are needed for a constellation of n."""
    assert largest_possible(np.array([5, 3, 3, 3])) == 4
    assert largest_possible(np.array([7, 7, 1, 1])) == 2
    assert largest_possible(np.array([], int)) == 0

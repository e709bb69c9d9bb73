"""Merging of double stars by the policy of each document, for constructed pairs and for the real sky."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gss.catalogue_tools.corrections.doubles import POLICIES, Doubles, merge, separable_rad, spoiled
from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.angles import ARCSEC_RAD, separation_rad
from gss.domain.errors import BadInput
from gss.domain.stars import FLAG_MULTIPLE, StarTable
from gss.instruments.registry import shipped_camera, shipped_registry

CLOSE_RAD = 1e-3
ALPHA_CEN = (71683, 71681)  # α Centauri A and B, 19″ apart in 1991


def _stars(offsets_rad: list[tuple[float, float]], v_mag: list[float]) -> StarTable:
    """Return stars near the x axis at small angles east and north of it, numbered from 1."""
    n = len(v_mag)
    east, north = np.array(offsets_rad, float).reshape(n, 2).T
    icrs = np.column_stack([np.ones(n), east, north])
    base = load_stars(3.0).take(np.arange(n))
    unit = icrs / np.linalg.norm(icrs, axis=1, keepdims=True)
    return replace(base, hip=np.arange(1, n + 1, dtype=np.int32), icrs=unit, v_mag=np.array(v_mag, float))


def test_photocentre_is_weighted_by_light() -> None:
    """A companion 2.5 mag fainter shifts the centre by s·l₂/(l₁+l₂) = s/11 (Moniteq 1983 §2.2), and the light is added."""
    merged = merge(
        _stars([(0, 0), (CLOSE_RAD, 0)], [4.0, 6.5]), Doubles("moniteq", 2 * CLOSE_RAD, largest_broadening=10.0)
    )
    assert len(merged.stars) == 1
    assert merged.stars.icrs[0, 1] == pytest.approx(CLOSE_RAD / 11, rel=1e-5)
    assert merged.stars.v_mag[0] == pytest.approx(4 - 2.5 * np.log10(1.1), abs=1e-12)
    assert merged.stars.flags[0] & FLAG_MULTIPLE
    assert (merged.groups, merged.members) == (1, 2)
    assert merged.largest_shift_rad == pytest.approx(CLOSE_RAD / 11, rel=1e-5)


def test_erlank_averages_the_position_without_the_light() -> None:
    """Erlank 2013 §4.3.2: the first option places the star midway, the second keeps both stars."""
    pair = _stars([(0, 0), (CLOSE_RAD, 0)], [4.0, 6.5])
    assert merge(pair, Doubles("erlank_combine", 2 * CLOSE_RAD)).stars.icrs[0, 1] == pytest.approx(
        CLOSE_RAD / 2, rel=1e-5
    )
    assert merge(pair, Doubles("erlank_keep", 2 * CLOSE_RAD)).stars is pair


def test_a_broadened_blend_is_rejected() -> None:
    """Equal stars at a distance s are broadened by s/2. They are rejected above half a σ and merged below it."""
    profile = shipped_camera("sunsat")
    sigma = separable_rad(profile) / 4
    wide = merge(_stars([(0, 0), (1.2 * sigma, 0)], [4.0, 4.0]), Doubles("moniteq"), profile)
    narrow = merge(_stars([(0, 0), (0.8 * sigma, 0)], [4.0, 4.0]), Doubles("moniteq"), profile)
    assert (len(wide.stars), sorted(wide.rejected.hip)) == (0, [1, 2])
    assert (len(narrow.stars), len(narrow.rejected)) == (1, 0)
    faint = merge(_stars([(0, 0), (1.2 * sigma, 0)], [4.0, 8.0]), Doubles("moniteq"), profile)
    assert (len(faint.stars), len(faint.rejected)) == (1, 0)


def test_faint_contaminants_are_ignored() -> None:
    """Contaminants fainter than the limit neither shift nor reject a star."""
    pair = _stars([(0, 0), (CLOSE_RAD, 0)], [4.0, 6.5])
    merged = merge(pair, Doubles("moniteq", 2 * CLOSE_RAD, contaminant_mag=6.0))
    assert np.array_equal(merged.stars.icrs, pair.icrs)


def test_only_huffman_merges_chains_of_stars() -> None:
    """Huffman's method merges a row of three close stars. Moniteq's method merges only the brightest with its
    neighbour.
    """
    row = _stars([(0, 0), (CLOSE_RAD, 0), (2 * CLOSE_RAD, 0)], [4.0, 5.0, 6.0])
    assert len(merge(row, Doubles("huffman", 1.5 * CLOSE_RAD)).stars) == 1
    by_moniteq = merge(row, Doubles("moniteq", 1.5 * CLOSE_RAD, largest_broadening=10.0))
    assert by_moniteq.stars.hip.tolist() == [1, 3]


def test_a_star_with_a_faint_neighbour_is_not_dropped() -> None:
    """The fainter star of a pair is always dropped, the brighter one only if the other is less than 2.5 mag fainter."""
    much_fainter = _stars([(0, 0), (CLOSE_RAD, 0)], [3.0, 5.6])
    slightly_fainter = _stars([(0, 0), (CLOSE_RAD, 0)], [3.0, 5.4])
    assert spoiled(much_fainter, 2 * CLOSE_RAD).tolist() == [False, True]
    assert spoiled(slightly_fainter, 2 * CLOSE_RAD).tolist() == [True, True]
    assert merge(much_fainter, Doubles("drop", 2 * CLOSE_RAD)).stars.hip.tolist() == [1]


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10_000), policy=st.sampled_from(POLICIES))
def test_merging_does_not_depend_on_the_order(seed: int, policy: str) -> None:
    """Shuffled rows give bit-identical stars and the same rejects, also for equal magnitudes."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 40))
    offsets_rad = [(float(x), float(y)) for x, y in rng.uniform(0, 4 * CLOSE_RAD, (n, 2))]
    stars = _stars(offsets_rad, [float(m) for m in rng.integers(2, 9, n)])
    policy_of = Doubles(policy, CLOSE_RAD)
    merged, shuffled = merge(stars, policy_of), merge(stars.take(rng.permutation(n)), policy_of)
    first, second = np.argsort(merged.stars.hip), np.argsort(shuffled.stars.hip)
    for name in ("hip", "icrs", "v_mag", "flags"):
        assert np.array_equal(getattr(merged.stars, name)[first], getattr(shuffled.stars, name)[second]), name
    assert sorted(merged.rejected.hip) == sorted(shuffled.rejected.hip)
    assert merged.largest_shift_rad == shuffled.largest_shift_rad


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_merging_conserves_light(seed: int) -> None:
    """Huffman's merging conserves the total flux and its centre."""
    rng = np.random.default_rng(seed)
    stars = _stars([(float(x), float(y)) for x, y in rng.uniform(0, 3e-5, (20, 2))], list(rng.uniform(1, 8, 20)))
    merged = merge(stars, Doubles("huffman", 1e-5)).stars

    def light(table: StarTable) -> np.ndarray:
        return np.asarray(10 ** (-0.4 * table.v_mag))

    assert light(merged).sum() == pytest.approx(light(stars).sum(), rel=1e-12)
    assert light(merged) @ merged.icrs == pytest.approx(light(stars) @ stars.icrs, abs=1e-9)


@pytest.mark.parametrize("name", sorted(i.name for i in shipped_registry().all() if i.profile.chain))
def test_few_stars_remain_to_be_merged(name: str) -> None:
    """After Huffman's merging to V 6, a second merging finds at most 2 % as many groups."""
    profile = shipped_camera(name)
    merged = merge(load_stars(6.0), Doubles("huffman"), profile)
    assert len(merged.stars) + merged.members - merged.groups == len(load_stars(6.0))
    second = merge(merged.stars, Doubles("huffman"), profile)
    assert second.groups <= 0.02 * max(merged.groups, 50)


def test_alpha_centauri_becomes_one_star_for_a_wide_camera() -> None:
    """The two stars of α Cen, 19″ apart, become one centre of light of −0.3 mag between them."""
    stars = load_stars(2.0)
    rows = [int(np.flatnonzero(stars.hip == hip)[0]) for hip in ALPHA_CEN]
    merged = merge(stars, Doubles("moniteq"), shipped_camera("sunsat")).stars
    row = int(np.flatnonzero(merged.hip == ALPHA_CEN[0])[0])
    assert ALPHA_CEN[1] not in merged.hip
    assert merged.v_mag[row] == pytest.approx(-0.29, abs=0.05)
    first, second = stars.icrs[rows]
    assert separation_rad(first, merged.icrs[row]) + separation_rad(merged.icrs[row], second) == pytest.approx(
        separation_rad(first, second)
    )
    assert separation_rad(first, second) / ARCSEC_RAD == pytest.approx(19, abs=2)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Doubles("best"), "policy"),
        (lambda: Doubles(separation_rad=0.0), "separation"),
        (lambda: Doubles(separation_rad=float("nan")), "separation"),
        (lambda: Doubles(largest_broadening=0.0), "limits for doubles"),
        (lambda: merge(load_stars(2.0), Doubles()), "need a separation"),
    ],
)
def test_invalid_policies_are_rejected(make, message) -> None:  # type: ignore[no-untyped-def]
    """Each invalid value is rejected, and the error names the field."""
    with pytest.raises(BadInput, match=message):
        make()


def test_empty_and_single_star_tables_are_unchanged() -> None:
    """Tables of no stars and of one star do not change under any policy."""
    for policy in POLICIES:
        for n in (0, 1):
            some_stars = load_stars(2.0).take(np.arange(n))
            assert len(merge(some_stars, Doubles(policy, CLOSE_RAD)).stars) == n

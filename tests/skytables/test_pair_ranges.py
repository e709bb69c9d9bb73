"""Ranges of the pair table and of its k-vector, compared with brute force."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gss.domain.errors import BadInput
from gss.skytables.kvector import k_vector
from gss.skytables.pairs import distance_table_of_units


def sphere(n: int, seed: int) -> np.ndarray:
    """Return random directions."""
    return Rotation.random(n, rng=np.random.default_rng(seed)).apply([0, 0, 1])


@pytest.mark.parametrize("n", [60, 1700])
def test_all_pairs_in_range_and_no_others(n: int) -> None:
    """For small and large lists the table contains exactly the pairs of a brute-force search, in ascending order."""
    unit = sphere(n, 1)
    table = distance_table_of_units(unit, 0.01, 0.1)
    cosine = np.clip(unit @ unit.T, -1, 1)
    i, j = np.nonzero(np.triu(np.ones((n, n), bool), 1))
    angle = np.arccos(cosine[i, j])
    assert len(table) == int(((angle >= 0.01) & (angle <= 0.1)).sum())
    assert (np.diff(table.distance_rad) >= 0).all()
    assert (table.first < table.second).all()
    assert np.allclose(np.cos(table.distance_rad), cosine[table.first, table.second], atol=1e-12)


TABLE = distance_table_of_units(sphere(120, 2), 0.0, 1.0)


@settings(max_examples=200, deadline=None)
@given(st.floats(-0.2, 1.2), st.floats(0, 0.3))
def test_ranges_equal_a_comparison_of_every_value(low: float, width: float) -> None:
    """Table and k-vector give the same rows as a comparison of every value, also at the ends and outside."""
    ends = np.array([low]), np.array([low + width])
    for start, stop in (TABLE.ranges(*ends), k_vector(TABLE.distance_rad).ranges(TABLE.distance_rad, *ends)):
        assert start[0] == np.count_nonzero(TABLE.distance_rad < low)
        assert stop[0] == np.count_nonzero(TABLE.distance_rad <= low + width)


def test_an_interval_of_zero_width_contains_its_distance() -> None:
    """An interval of zero width at a pair's distance contains the pair."""
    distances_rad = TABLE.distance_rad
    for start, stop in (
        TABLE.ranges(distances_rad, distances_rad),
        k_vector(distances_rad).ranges(distances_rad, distances_rad, distances_rad),
    ):
        assert (stop - start >= 1).all()


def test_empty_tables_give_empty_ranges() -> None:
    """Tables of no stars, one star or no pair in range return empty slices and raise no error."""
    for unit in (np.zeros((0, 3)), sphere(1, 3), np.array([[0, 0, 1.0], [0, 0, -1.0]])):
        table, ends = distance_table_of_units(unit, 0.0, 0.5), (np.array([0.0, 0.2]), np.array([0.1, 0.5]))
        distances_rad = table.distance_rad
        for start, stop in (table.ranges(*ends), k_vector(distances_rad).ranges(distances_rad, *ends)):
            assert (start == stop).all()


def test_invalid_limits_are_rejected() -> None:
    """Limits in the wrong order raise BadInput."""
    with pytest.raises(BadInput):
        distance_table_of_units(sphere(5, 4), 0.5, 0.1)

"""The pair table and its index."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gss.domain.errors import BadInput
from gss.pipeline.identify.kvector import pair_table


def sphere(n: int, seed: int) -> np.ndarray:
    return Rotation.random(n, rng=np.random.default_rng(seed)).apply([0, 0, 1])


@pytest.mark.parametrize("n", [60, 1700])
def test_all_pairs_in_range_and_no_others(n: int) -> None:
    """Both ways of building hold exactly the pairs of a brute-force search, ascending."""
    unit = sphere(n, 1)
    table = pair_table(unit, 0.01, 0.1)
    cosine = np.clip(unit @ unit.T, -1, 1)
    i, j = np.nonzero(np.triu(np.ones((n, n), bool), 1))
    angle = np.arccos(cosine[i, j])
    assert len(table) == int(((angle >= 0.01) & (angle <= 0.1)).sum())
    assert (np.diff(table.distance_rad) >= 0).all()
    assert (table.first < table.second).all()
    assert np.allclose(np.cos(table.distance_rad), cosine[table.first, table.second], atol=1e-12)


TABLE = pair_table(sphere(120, 2), 0.0, 1.0)


@settings(max_examples=200, deadline=None)
@given(st.floats(-0.2, 1.2), st.floats(0, 0.3))
def test_ranges_are_those_of_a_binary_search(low: float, width: float) -> None:
    """Any interval gives the same slice as searchsorted, at the ends and outside too."""
    start, stop = TABLE.ranges(np.array([low]), np.array([low + width]))
    assert start[0] == np.searchsorted(TABLE.distance_rad, low, side="left")
    assert stop[0] == np.searchsorted(TABLE.distance_rad, low + width, side="right")


def test_exact_distances_are_inside_their_own_interval() -> None:
    """Closed intervals of zero width find the pair itself."""
    start, stop = TABLE.ranges(TABLE.distance_rad, TABLE.distance_rad)
    assert (stop - start >= 1).all()


def test_empty_tables_answer_empty() -> None:
    """No stars, one star or no pair in range give empty slices, not errors."""
    for unit in (np.zeros((0, 3)), sphere(1, 3), np.array([[0, 0, 1.0], [0, 0, -1.0]])):
        start, stop = pair_table(unit, 0.0, 0.5).ranges(np.array([0.0, 0.2]), np.array([0.1, 0.5]))
        assert (start == stop).all()


def test_impossible_limits_are_refused() -> None:
    """Limits out of order are BadInput."""
    with pytest.raises(BadInput):
        pair_table(sphere(5, 4), 0.5, 0.1)

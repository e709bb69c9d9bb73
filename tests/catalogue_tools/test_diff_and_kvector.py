"""The difference of two catalogues, and the k-vector against plain bisection."""

from dataclasses import replace

import numpy as np
import pytest

from gss.catalogue_tools.diff import compare
from gss.catalogue_tools.formats.section_contents import line_index
from gss.catalogue_tools.onboard import decode, encode
from gss.catalogue_tools.sources.hipparcos import load_stars, propagate
from gss.domain.errors import BadInput
from gss.skytables.kvector import k_vector
from gss.skytables.pairs import distance_table


def onboard(stars, format_name="sunsat"):
    return decode(encode(stars, distance_table(stars, 0.004, 0.5), format_name, format_name), stars.hip)


def test_catalogue_does_not_differ_from_itself():
    """Nothing added, dropped, moved or changed; the order of the rows does not matter."""
    stars = load_stars(3.0)
    shuffled = stars.take(np.random.default_rng(1).permutation(len(stars)))
    d = compare(onboard(stars), onboard(shuffled))
    assert (len(d.added), len(d.dropped), len(d.moved), len(d.magnitude_changed)) == (0, 0, 0, 0)
    assert sorted(d.same) == sorted(stars.hip)
    assert d.pairs[0] == d.pairs[1]


def test_every_kind_of_change_is_listed():
    """One star added, two removed, fast ones moved in a century, one with a new magnitude."""
    stars = load_stars(3.0)
    v_mag = stars.v_mag.copy()
    v_mag[10] += 0.3
    new = propagate(replace(stars, v_mag=v_mag), 2091.25).take(np.arange(2, len(stars)))
    d = compare(onboard(stars.take(np.arange(len(stars) - 1))), onboard(new))
    assert d.added.tolist() == [stars.hip[-1]]
    assert sorted(d.dropped) == sorted(stars.hip[:2])
    assert d.magnitude_changed.tolist() == [stars.hip[10]]
    arcturus, mintaka = 69673, 25930
    assert arcturus in d.moved
    assert d.moved_rad[d.moved == arcturus][0] == pytest.approx(228 / 206265, rel=0.02)
    assert mintaka in d.same
    assert len(d.moved) + len(d.same) == len(stars) - 3


def test_k_vector_answers_every_query():
    """It returns exactly the rows of a binary search, for queries inside, across and beyond the ends; counts follow the line."""
    d = distance_table(load_stars(4.5), 0.004, 0.24).distance_rad
    index = k_vector(d)
    rng = np.random.default_rng(2)
    lows = np.concatenate([rng.uniform(-0.01, 0.26, 500), d[[0, -1, 5]]])
    highs = lows + rng.uniform(0, 0.003, len(lows))
    start, end = index.ranges(d, lows, highs)
    np.testing.assert_array_equal(start, np.searchsorted(d, lows, "left"))
    np.testing.assert_array_equal(end, np.searchsorted(d, highs, "right"))
    line = index.start + index.step * np.arange(len(d))
    np.testing.assert_array_equal(index.k, np.count_nonzero(d[:, None] <= line, axis=0))


@pytest.mark.parametrize("table", [[], [0.1], [0.1, 0.1]])
def test_banks_store_no_k_vector_of_one_value(table):
    """A line needs two different values."""
    assert line_index(np.array(table, float)) is None


def test_an_unsorted_table_has_no_k_vector():
    """The values must be in ascending order."""
    with pytest.raises(BadInput, match="ascending"):
        k_vector(np.array([0.2, 0.1]))

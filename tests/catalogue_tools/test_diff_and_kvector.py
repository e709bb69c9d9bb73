"""The comparison of two catalogues, and the k-vector compared with bisection."""

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
    """Return the decoded bank of a star table."""
    return decode(encode(stars, distance_table(stars, 0.004, 0.5), format_name, format_name), stars.hip)


def test_a_catalogue_has_no_differences_from_itself():
    """A catalogue in another order of rows has no added, dropped, moved or changed stars."""
    stars = load_stars(3.0)
    shuffled = stars.take(np.random.default_rng(1).permutation(len(stars)))
    difference = compare(onboard(stars), onboard(shuffled))
    assert (
        len(difference.added),
        len(difference.dropped),
        len(difference.moved),
        len(difference.magnitude_changed),
    ) == (0, 0, 0, 0)
    assert sorted(difference.same) == sorted(stars.hip)
    assert difference.pairs[0] == difference.pairs[1]


def test_every_kind_of_change_is_listed():
    """An added star, two removed stars, stars that moved within a century and a star with a new magnitude are listed."""
    stars = load_stars(3.0)
    v_mag = stars.v_mag.copy()
    v_mag[10] += 0.3
    new = propagate(replace(stars, v_mag=v_mag), 2091.25).take(np.arange(2, len(stars)))
    difference = compare(onboard(stars.take(np.arange(len(stars) - 1))), onboard(new))
    assert difference.added.tolist() == [stars.hip[-1]]
    assert sorted(difference.dropped) == sorted(stars.hip[:2])
    assert difference.magnitude_changed.tolist() == [stars.hip[10]]
    arcturus, mintaka = 69673, 25930
    assert arcturus in difference.moved
    assert difference.moved_rad[difference.moved == arcturus][0] == pytest.approx(228 / 206265, rel=0.02)
    assert mintaka in difference.same
    assert len(difference.moved) + len(difference.same) == len(stars) - 3


def test_k_vector_ranges_equal_bisection():
    """The k-vector returns exactly the rows of a binary search, for ranges inside, across and beyond the ends. Its
    counts follow the definition.
    """
    distances_rad = distance_table(load_stars(4.5), 0.004, 0.24).distance_rad
    index = k_vector(distances_rad)
    rng = np.random.default_rng(2)
    lows = np.concatenate([rng.uniform(-0.01, 0.26, 500), distances_rad[[0, -1, 5]]])
    highs = lows + rng.uniform(0, 0.003, len(lows))
    start, end = index.ranges(distances_rad, lows, highs)
    np.testing.assert_array_equal(start, np.searchsorted(distances_rad, lows, "left"))
    np.testing.assert_array_equal(end, np.searchsorted(distances_rad, highs, "right"))
    line = index.start + index.step * np.arange(len(distances_rad))
    np.testing.assert_array_equal(index.k, np.count_nonzero(distances_rad[:, None] <= line, axis=0))


@pytest.mark.parametrize("table", [[], [0.1], [0.1, 0.1]])
def test_banks_have_no_k_vector_of_a_single_value(table):
    """A table without two different values has no k-vector."""
    assert line_index(np.array(table, float)) is None


def test_an_unsorted_table_is_rejected():
    """A k-vector needs values in ascending order."""
    with pytest.raises(BadInput, match="ascending"):
        k_vector(np.array([0.2, 0.1]))

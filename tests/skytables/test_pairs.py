"""The distance table compared with brute force and with numbers in the documents."""

import numpy as np
import pytest

from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.angles import separation_rad
from gss.domain.errors import BadInput
from gss.skytables.pairs import distance_table, distance_table_of_units


def test_table_equals_brute_force():
    """Pairs and distances equal those of a comparison of every star with every other."""
    stars = load_stars(4.0)
    low, high = np.radians(0.25), np.radians(20)
    table = distance_table(stars, low, high)
    first, second = np.triu_indices(len(stars), 1)
    distance = separation_rad(stars.icrs[first], stars.icrs[second])
    in_range = (distance >= low) & (distance <= high)
    assert set(zip(table.first.tolist(), table.second.tolist(), strict=True)) == set(
        zip(first[in_range].tolist(), second[in_range].tolist(), strict=True)
    )
    assert np.abs(np.sort(distance[in_range]) - table.distance_rad).max() < 1e-15


def test_the_table_is_sorted_with_the_lower_row_first():
    """Distances are in ascending order and within the limits. The first row of a pair is the lower one."""
    table = distance_table(load_stars(5.0), np.radians(0.25), np.radians(13.9))
    assert np.all(np.diff(table.distance_rad) >= 0)
    assert np.all(table.first < table.second)
    assert table.distance_rad[0] >= table.min_rad
    assert table.distance_rad[-1] <= table.max_rad


def test_small_distances_are_accurate():
    """A distance of 0.2″ is accurate to one part in a million. The arccosine would not be."""
    angle = 1e-6
    unit = np.array([[1.0, 0.0, 0.0], [np.cos(angle), np.sin(angle), 0.0]])
    assert distance_table_of_units(unit, 0.0, 0.1).distance_rad[0] == pytest.approx(angle, rel=1e-6)


def test_distances_up_to_180_degrees_are_supported():
    """With limits of 0° and 180° every pair is listed, including opposite points."""
    unit = np.array([[0, 0, 1.0], [0, 0, -1.0], [1.0, 0, 0]])
    table = distance_table_of_units(unit, 0.0, np.pi)
    assert table.distance_rad == pytest.approx([np.pi / 2, np.pi / 2, np.pi])


def test_pairs_of_the_whole_sky_to_sixth_magnitude():
    """Stars of V < 6 have 207 169 pairs within 13.9° (4 995 stars). Relative to the square of the number of stars, they
    agree with the document's 203 270 pairs (4 941 stars, V from Hp).
    """
    stars = load_stars(6.0)
    stars = stars.take(stars.v_mag < 6.0)
    table = distance_table(stars, 0.0, np.radians(13.9))
    assert len(stars) == 4995
    assert len(table) == 207_169
    assert len(table) / len(stars) ** 2 == pytest.approx(203_270 / 4_941**2, rel=0.005)


def test_one_star_has_no_pairs():
    """Fewer than two stars give an empty table and no error."""
    assert len(distance_table(load_stars().take(np.array([0])), 0.0, 1.0)) == 0


@pytest.mark.parametrize(("low", "high"), [(1.0, 0.5), (0.5, 0.5), (-0.1, 0.5), (0.1, 4.0), (float("nan"), 1.0)])
def test_invalid_limits_are_rejected(low, high):
    """Limits that are out of order, equal, negative, above 180° or not a number raise BadInput."""
    with pytest.raises(BadInput, match="invalid distance limits"):
        distance_table(load_stars(3.0), low, high)

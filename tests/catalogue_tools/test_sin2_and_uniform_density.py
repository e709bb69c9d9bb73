"""FAR-MST's directory and reduced catalogue, compared with brute force and with the document's figures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gss.catalogue_tools.corrections.doubles import Doubles, merge
from gss.catalogue_tools.envelope.field import CircularField
from gss.catalogue_tools.selection.uniform_density import (
    reduce_catalogue,
    square_field,
    survey_attitudes,
)
from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.errors import BadInput
from gss.domain.frames import cam_from_icrs, ra_dec_roll_rad
from gss.domain.stars import StarTable
from gss.skytables.pairs import distance_table
from gss.skytables.sin2 import sin2_directory


def test_the_directory_agrees_with_brute_force() -> None:
    """The directory contains all pairs below the limit, with sin² as calculated from the cross product."""
    stars = load_stars(3.5)
    directory = sin2_directory(distance_table(stars, 0.0, 0.5), len(stars))
    i, j = np.triu_indices(len(stars), 1)
    cosine = np.einsum("ij,ij->i", stars.icrs[i], stars.icrs[j])
    assert len(directory) == np.count_nonzero(cosine >= np.cos(0.5))
    across = np.cross(stars.icrs[directory.first], stars.icrs[directory.second])
    np.testing.assert_allclose(directory.sin2, np.sum(across**2, axis=1), atol=1e-14)


def test_ranges_of_the_directory_are_exact() -> None:
    """400 random ranges, some with ends equal to table values, give exactly the values found by comparison."""
    stars = load_stars(3.5)
    directory = sin2_directory(distance_table(stars, 0.0, 0.6), len(stars))
    rng = np.random.default_rng(1)
    low = rng.uniform(-0.02, 0.34, 400)
    low[::4] = rng.choice(directory.sin2, 100)
    high = low + rng.exponential(3e-3, 400)
    high[1::4] = np.maximum(low[1::4], rng.choice(directory.sin2, 100))
    start, end = directory.ranges(low, high)
    for k in range(400):
        inside = np.flatnonzero((directory.sin2 >= low[k]) & (directory.sin2 <= high[k]))
        assert np.array_equal(np.arange(start[k], end[k]), inside)


def test_the_sorted_table_is_nearly_a_straight_line() -> None:
    """sin²θ of the sorted pairs deviates from a straight line by at most 5 % for 30° (Huffman 2006 §5.5.4)."""
    stars = load_stars(4.4)
    sin2 = sin2_directory(distance_table(stars, 0.0, np.radians(30)), len(stars)).sin2
    share = (sin2 - sin2[0]) / (sin2[-1] - sin2[0])
    assert np.max(np.abs(share - np.linspace(0, 1, len(share)))) < 0.05


def test_distances_beyond_a_right_angle_are_rejected() -> None:
    """Pairs beyond 90° are rejected, because sin² is ambiguous there."""
    stars = load_stars(2.0)
    with pytest.raises(BadInput, match="90"):
        sin2_directory(distance_table(stars, 0.0, 2.5), len(stars))


def test_an_empty_directory_has_no_ranges() -> None:
    """An empty directory returns no pairs and raises no error."""
    empty = sin2_directory(distance_table(load_stars(0.0), 0.0, 1e-6), 4)
    start, end = empty.ranges(np.array([0.1]), np.array([0.2]))
    assert (len(empty), int(start[0]), int(end[0])) == (0, 0, 0)


def test_the_brightest_stars_of_each_field_are_kept() -> None:
    """The kept stars are exactly the eight brightest of each field, found by brute force over all pointings."""
    stars = load_stars(4.5)
    attitudes = survey_attitudes(np.radians(12))
    shape = square_field(np.radians(36))
    reduced = reduce_catalogue(stars, shape, attitudes, 8)
    expected = np.zeros(len(stars), bool)
    for rotation in attitudes:
        inside = np.flatnonzero(shape.inside(stars.icrs @ rotation.T))
        expected[inside[np.argsort(stars.v_mag[inside], kind="stable")][:8]] = True
    np.testing.assert_array_equal(reduced.kept, expected)
    for k in (0, 40, len(attitudes) - 1):
        count = np.count_nonzero(shape.inside(stars.icrs[reduced.kept] @ attitudes[k].T))
        assert reduced.per_field[k] == count
    assert reduced.per_field.min() >= 8


def test_the_540_stars_of_huffman_are_reproduced() -> None:
    """The eight brightest stars per 36° square are about 540 of the 5 060 stars of V < 6 (Huffman 2006 §5.5.4; dossier
    §3.17: 546).
    """
    stars = load_stars(6.0)
    reduced = reduce_catalogue(stars, square_field(np.radians(36)), survey_attitudes(np.radians(2)), 8)
    assert abs(int(reduced.kept.sum()) - 540) < 30
    assert abs(len(stars) - 5060) < 80


def test_a_circular_field_is_supported() -> None:
    """In every circle the four brightest stars are kept, or all if there are fewer."""
    stars, radius_rad = load_stars(3.0), np.radians(20)
    attitudes = survey_attitudes(np.radians(15))
    reduced = reduce_catalogue(stars, CircularField(radius_rad), attitudes, 4)
    available = np.count_nonzero(attitudes[:, 2] @ stars.icrs.T >= np.cos(radius_rad), axis=1)
    assert np.all(reduced.per_field >= np.minimum(available, 4))
    assert np.mean(reduced.per_field < 4) == pytest.approx(np.mean(available < 4))
    assert 0 < reduced.kept.sum() < len(stars)


def test_survey_pointings_leave_no_gap() -> None:
    """No direction is farther from a pointing than the step. A step of zero is rejected."""
    boresights = survey_attitudes(np.radians(5))[:, 2]
    rng = np.random.default_rng(3)
    directions = rng.normal(size=(2000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    assert np.degrees(np.arccos(np.max(directions @ boresights.T, axis=1).min())) < 5
    with pytest.raises(BadInput, match="step"):
        survey_attitudes(0.0)


def test_survey_attitudes_have_the_requested_roll() -> None:
    """Each attitude is that of a camera at a right ascension and declination with the requested roll."""
    for attitude in survey_attitudes(np.radians(20), 0.7)[::7]:
        ra, dec, roll = ra_dec_roll_rad(attitude)
        assert roll == pytest.approx(0.7)
        np.testing.assert_allclose(attitude, cam_from_icrs(ra, dec, roll), atol=1e-12)


def _pair(m1: float, m2: float, distance_rad: float) -> StarTable:
    """Return two stars with these magnitudes at a distance."""
    stars = load_stars(3.0).take(np.arange(2))
    icrs = np.array([[1.0, 0, 0], [np.cos(distance_rad), np.sin(distance_rad), 0]])
    return replace(stars, icrs=icrs, v_mag=np.array([m1, m2]))


@pytest.mark.parametrize(
    ("m1", "m2", "merged_mag", "weight"), [(3, 3, 2.2474, 0.5), (2, 4, 1.8403, 0.8632), (1, 5, 0.9731, 0.9755)]
)
def test_doubles_add_their_light(m1: float, m2: float, merged_mag: float, weight: float) -> None:
    """The magnitude and position of a merged pair agree with eqs. 6.1 and 6.2 in base 10."""
    merged = merge(_pair(m1, m2, 1e-3), Doubles("huffman", 2e-3)).stars
    assert len(merged) == 1
    assert merged.v_mag[0] == pytest.approx(merged_mag, abs=1e-4)
    assert np.arctan2(merged.icrs[0, 1], merged.icrs[0, 0]) == pytest.approx((1 - weight) * 1e-3, rel=1e-3)


def test_separated_stars_are_not_merged() -> None:
    """Stars farther apart than the separation are not merged."""
    assert len(merge(_pair(3, 3, 1e-3), Doubles("huffman", 5e-4)).stars) == 2

"""Moniteq's linked star list: counts and symmetry of the links, and comparison with the spherical Delaunay
triangulation.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.rotation import matrix_from_quaternion, random_quaternion
from gss.skytables.neighbours import NeighbourLinks, figures, link_distances, neighbour_links


@lru_cache
def _links() -> tuple[np.ndarray, NeighbourLinks]:
    """Return 3000 stars and their neighbour links."""
    stars = load_stars(8.0).brighter_than(5.6)
    return stars.icrs[:3000], neighbour_links(stars.icrs[:3000])


def test_counts_agree_with_eulers_formula() -> None:
    """3000 stars have 3n − 6 links, six neighbours on average, and 8n − 12 integers: 36 kbyte (document: 70)."""
    statistics = figures(_links()[1])
    assert (statistics.stars, statistics.links, statistics.integers) == (3000, 3 * 3000 - 6, 8 * 3000 - 12)
    assert statistics.mean == pytest.approx(6, abs=0.01)
    assert statistics.fewest >= 3
    assert statistics.size_bytes == pytest.approx(36_000, rel=0.01)


def test_links_are_symmetric_and_have_no_loops() -> None:
    """Each link is stored once at both ends, in ascending order. No star is linked to itself."""
    _, net = _links()
    for row in range(0, 3000, 37):
        neighbours = net.of(row)
        assert np.all(np.diff(neighbours) > 0)
        assert row not in neighbours
        assert all(row in net.of(int(other)) for other in neighbours)


def test_links_are_the_pairs_with_an_empty_circle() -> None:
    """Two stars are linked exactly if some circle through both contains no star. This is checked for the neighbourhoods
    of 12 random stars.
    """
    icrs, net = _links()
    rng = np.random.default_rng(2)
    for row in rng.choice(3000, 12, replace=False):
        nearest = np.argsort(-(icrs @ icrs[row]))[1:25]
        for other in nearest:
            third = np.setdiff1d(nearest, [other])
            normal = np.cross(icrs[other] - icrs[row], icrs[third] - icrs[row])
            height = normal @ icrs[row]
            normal *= np.sign(height)[:, None]
            # A plane through two stars and a third one is a face of the hull if all other stars are below it.
            above = (icrs @ normal.T > np.abs(height) + 1e-13).sum(axis=0)
            assert bool(np.any(above == 0)) == bool(other in net.of(int(row)))


def test_the_links_do_not_depend_on_rotation() -> None:
    """A rotation of the sky does not change the links."""
    icrs, net = _links()
    rotated = neighbour_links(icrs @ matrix_from_quaternion(random_quaternion(np.random.default_rng(3))).T)
    np.testing.assert_array_equal(net.start, rotated.start)
    np.testing.assert_array_equal(net.neighbour, rotated.neighbour)


def test_two_stars_with_the_same_direction_are_both_linked() -> None:
    """A star that is not on the hull is linked to the nearest star."""
    icrs = np.vstack([_links()[0][:50], _links()[0][7]])
    net = neighbour_links(icrs)
    assert all(len(net.of(row)) for row in range(51))


@pytest.mark.parametrize("n", range(5))
def test_up_to_four_stars_are_all_linked(n: int) -> None:
    """Up to four stars are each linked to all others."""
    net = neighbour_links(_links()[0][:n])
    assert len(net) == n
    assert net.links == n * (n - 1) // 2
    assert figures(net).stars == n


def test_link_lengths_are_sorted_and_correct() -> None:
    """The length list contains every link once, in ascending order, with the angle between its stars."""
    icrs, net = _links()
    lengths = link_distances(net, icrs)
    assert len(lengths.first) == net.links
    assert np.all(np.diff(lengths.distance_rad) >= 0)
    cosine = np.sum(icrs[lengths.first] * icrs[lengths.second], axis=1)
    np.testing.assert_allclose(np.cos(lengths.distance_rad), cosine, atol=1e-12)


def test_the_links_have_one_row_per_star() -> None:
    """The links have one row per row of the star table."""
    stars = load_stars(3.0)
    assert len(neighbour_links(stars.icrs)) == len(stars)


@pytest.mark.parametrize("positions", [1, 3, 40])
def test_stars_on_a_great_circle_are_connected(positions: int) -> None:
    """Stars without a convex hull, on a great circle or at a few positions on it, form one connected network with
    symmetric links.
    """
    angle = 2 * np.pi * (np.arange(40) % positions) / 40
    links = neighbour_links(np.column_stack([np.cos(angle), np.sin(angle), np.zeros(40)]))
    first, second = links.pairs()
    assert first.size == links.links
    reached = np.zeros(40, bool)
    reached[0] = True
    for _ in range(40):
        reached[second[reached[first]]] = True
        reached[first[reached[second]]] = True
    assert reached.all()
    assert all(row in links.of(int(other)) for row in range(40) for other in links.of(row))

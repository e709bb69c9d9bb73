"""Moniteq's linked star list: counts and symmetry of the links, and comparison with the spherical Delaunay net."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest

from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.rotation import matrix_from_quaternion, random_quaternion
from gss.skytables.neighbours import NeighbourLinks, figures, link_distances, neighbour_links


@lru_cache
def _net() -> tuple[np.ndarray, NeighbourLinks]:
    stars = load_stars(8.0).brighter_than(5.6)
    return stars.icrs[:3000], neighbour_links(stars.icrs[:3000])


def test_counts_are_eulers() -> None:
    """3000 stars have 3n − 6 links, six neighbours on average, and 8n − 12 integers: 36 kbyte (document: 70)."""
    f = figures(_net()[1])
    assert (f.stars, f.links, f.integers) == (3000, 3 * 3000 - 6, 8 * 3000 - 12)
    assert f.mean == pytest.approx(6, abs=0.01)
    assert f.fewest >= 3
    assert f.size_bytes == pytest.approx(36_000, rel=0.01)


def test_links_go_both_ways_and_never_to_oneself() -> None:
    """Each link is stored once at both ends, in ascending order. No star is linked to itself."""
    _, net = _net()
    for row in range(0, 3000, 37):
        neighbours = net.of(row)
        assert np.all(np.diff(neighbours) > 0)
        assert row not in neighbours
        assert all(row in net.of(int(other)) for other in neighbours)


def test_links_are_those_of_empty_circles() -> None:
    """Two stars are linked exactly if some circle through both contains no star.

    The test checks the neighbourhoods of 12 random stars.
    """
    icrs, net = _net()
    rng = np.random.default_rng(2)
    for row in rng.choice(3000, 12, replace=False):
        near = np.argsort(-(icrs @ icrs[row]))[1:25]
        for other in near:
            third = np.setdiff1d(near, [other])
            normal = np.cross(icrs[other] - icrs[row], icrs[third] - icrs[row])
            height = normal @ icrs[row]
            normal *= np.sign(height)[:, None]
            # A plane through two stars and a third one is a face of the hull if all other stars are below it.
            above = (icrs @ normal.T > np.abs(height) + 1e-13).sum(axis=0)
            assert bool(np.any(above == 0)) == bool(other in net.of(int(row)))


def test_the_net_turns_with_the_sky() -> None:
    """A rotation of the sky does not change the links."""
    icrs, net = _net()
    turned = neighbour_links(icrs @ matrix_from_quaternion(random_quaternion(np.random.default_rng(3))).T)
    np.testing.assert_array_equal(net.start, turned.start)
    np.testing.assert_array_equal(net.neighbour, turned.neighbour)


def test_two_stars_at_one_place_are_both_in_the_net() -> None:
    """A star that is not on the hull is linked to the nearest star."""
    icrs = np.vstack([_net()[0][:50], _net()[0][7]])
    net = neighbour_links(icrs)
    assert all(len(net.of(row)) for row in range(51))


@pytest.mark.parametrize("n", range(5))
def test_a_handful_are_all_neighbours(n: int) -> None:
    """If there are at most four stars, each is linked to all others."""
    net = neighbour_links(_net()[0][:n])
    assert len(net) == n
    assert net.links == n * (n - 1) // 2
    assert figures(net).stars == n


def test_lengths_ascend_and_belong_to_their_links() -> None:
    """The length list contains every link once, in ascending order, with the angle between its stars."""
    icrs, net = _net()
    lengths = link_distances(net, icrs)
    assert len(lengths.first) == net.links
    assert np.all(np.diff(lengths.distance_rad) >= 0)
    cosine = np.sum(icrs[lengths.first] * icrs[lengths.second], axis=1)
    np.testing.assert_allclose(np.cos(lengths.distance_rad), cosine, atol=1e-12)


def test_a_star_table_gives_its_own_net() -> None:
    """The net has one row per row of the star table."""
    stars = load_stars(3.0)
    assert len(neighbour_links(stars.icrs)) == len(stars)


@pytest.mark.parametrize("spots", [1, 3, 40])
def test_stars_in_one_plane_or_at_one_place_are_linked_too(spots: int) -> None:
    """Stars without a hull, on one great circle or at few positions on it, form one connected net with both ends of
    each link.
    """
    angle = 2 * np.pi * (np.arange(40) % spots) / 40
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

"""CubeStar's tracking step: each star is matched with the nearest predicted star within the radius."""

from __future__ import annotations

import numpy as np

from gss.pipeline.track.nearest import match_nearest

RADIUS_RAD = np.radians(0.3)
ALL = np.ones(3, bool)


def _directions(*degrees: float) -> np.ndarray:
    """Return directions at these angles in degrees from the boresight towards +x."""
    angle = np.radians(degrees)
    return np.column_stack([np.sin(angle), 0 * angle, np.cos(angle)])


def test_the_radius_is_exact() -> None:
    """A star 0.299° away is matched, and one 0.301° away is not."""
    assert match_nearest(_directions(0.299), _directions(0, 5, 10), ALL, RADIUS_RAD).tolist() == [0]
    assert match_nearest(_directions(0.301), _directions(0, 5, 10), ALL, RADIUS_RAD).tolist() == [-1]


def test_the_nearest_star_is_matched() -> None:
    """If two predicted stars are within the radius, the nearer is matched."""
    assert match_nearest(_directions(0.2), _directions(0, 0.3, 10), ALL, RADIUS_RAD).tolist() == [1]


def test_stars_outside_the_reduced_list_are_not_matched() -> None:
    """A star outside the reduced list is not matched, even if it is the nearest; its neighbour is."""
    allowed = np.array([True, False, True])
    assert match_nearest(_directions(0.2), _directions(0, 0.25, 10), allowed, RADIUS_RAD).tolist() == [0]
    assert match_nearest(_directions(0.2), _directions(0, 0.25, 10), ~ALL, RADIUS_RAD).tolist() == [-1]


def test_an_empty_list_gives_no_matches() -> None:
    """An empty list of centroids gives no matches."""
    assert match_nearest(np.empty((0, 3)), _directions(0, 1, 2), ALL, RADIUS_RAD).tolist() == []

"""CubeStar's tracking step: nearest predicted star within the radius."""

from __future__ import annotations

import numpy as np

from gss.pipeline.track.nearest import match_nearest

RADIUS_RAD = np.radians(0.3)
ALL = np.ones(3, bool)


def _at(*degrees: float) -> np.ndarray:
    """Directions that many degrees from the boresight towards +x."""
    a = np.radians(degrees)
    return np.column_stack([np.sin(a), 0 * a, np.cos(a)])


def test_the_radius_is_exact() -> None:
    """A star 0.299° away is matched, one 0.301° away is not."""
    assert match_nearest(_at(0.299), _at(0, 5, 10), ALL, RADIUS_RAD).tolist() == [0]
    assert match_nearest(_at(0.301), _at(0, 5, 10), ALL, RADIUS_RAD).tolist() == [-1]


def test_the_nearest_of_two_wins() -> None:
    """Where two predicted stars qualify, the nearer is taken."""
    assert match_nearest(_at(0.2), _at(0, 0.3, 10), ALL, RADIUS_RAD).tolist() == [1]


def test_stars_off_the_reduced_list_are_not_matched() -> None:
    """A star outside the list is not a candidate, however near; its neighbour is."""
    allowed = np.array([True, False, True])
    assert match_nearest(_at(0.2), _at(0, 0.25, 10), allowed, RADIUS_RAD).tolist() == [0]
    assert match_nearest(_at(0.2), _at(0, 0.25, 10), ~ALL, RADIUS_RAD).tolist() == [-1]


def test_no_centroids_no_matches() -> None:
    """An empty list gives no matches."""
    assert match_nearest(np.empty((0, 3)), _at(0, 1, 2), ALL, RADIUS_RAD).tolist() == []

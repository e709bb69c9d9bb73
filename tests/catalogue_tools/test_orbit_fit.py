"""A satellite's plane against the planes of a catalogue, compared with the angle between orbital poles."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

from gss.catalogue_tools.envelope.orbit_fit import orbit_fit
from gss.catalogue_tools.envelope.orbits import OrbitRanges, from_elements, from_tle

TLE = """1 25544U 98067A   26329.40198169  .00001764  00000-0  38792-4 0  9991
2 25544  97.6439 211.2001 0007417  17.6667  85.6398 15.20103472202489"""
START = datetime(2026, 11, 26, tzinfo=UTC)
MARGIN_RAD = float(np.radians(0.5))


def pole(planes: OrbitRanges, part: float) -> np.ndarray:
    """Return the pole of the plane after a fraction of the validity."""
    inclination, raan = np.mean(planes.inclination_rad), float(planes.raan_at(np.array([part]))[0])
    return np.array([np.sin(inclination) * np.sin(raan), -np.sin(inclination) * np.cos(raan), np.cos(inclination)])


def angle_rad(a: np.ndarray, b: np.ndarray) -> float:
    """Return the angle between two unit vectors."""
    return float(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b))


def test_the_plane_leaves_when_its_pole_is_the_margin_beyond_the_last_one() -> None:
    """The catalogue is for 14 days. At the predicted time the pole differs by the margin from the pole of the last day."""
    planes = from_tle(TLE, START, 14)
    fit = orbit_fit(planes, MARGIN_RAD, TLE, START)
    assert fit.inside
    assert fit.outside_rad < 1e-4
    assert fit.leaves is not None
    assert fit.leaves > START + timedelta(days=14)
    days = (fit.leaves - START) / timedelta(days=1)
    reached = from_tle(TLE, START, days)
    assert angle_rad(pole(reached, 1.0), pole(planes, 1.0)) == pytest.approx(MARGIN_RAD, rel=0.12)


@pytest.mark.parametrize(("inclination_deg", "raan_deg"), [(97.64, 250.0), (95.0, 211.0), (96.0, 208.0)])
def test_the_angle_of_a_plane_outside_is_that_between_the_poles(inclination_deg: float, raan_deg: float) -> None:
    """A plane that is outside never returns a time, because the catalogue is not valid now."""
    other = from_elements((np.radians(inclination_deg),) * 2, (np.radians(raan_deg),) * 2)
    fit = orbit_fit(other, MARGIN_RAD, TLE, START)
    expected = angle_rad(pole(other, 0.0), pole(from_tle(TLE, START, 1.0), 0.0))
    assert (fit.inside, fit.leaves) == (False, None)
    assert fit.outside_rad == pytest.approx(expected, rel=0.02)


def test_a_catalogue_for_all_nodes_is_never_left() -> None:
    """The node may have any value, also beyond a full rotation."""
    everywhere = from_elements((np.radians(97.0), np.radians(98.5)), (0.0, 2 * np.pi))
    fit = orbit_fit(everywhere, MARGIN_RAD, TLE, START)
    assert (fit.inside, fit.outside_rad, fit.leaves) == (True, 0.0, None)

"""Sun, Moon and planets during the validity of a catalogue, compared with astropy and with observed events."""

from __future__ import annotations

import json
import warnings
from collections.abc import Iterator
from datetime import UTC, datetime, timedelta

import astropy.units as u
import numpy as np
import pytest
from astropy.coordinates import get_body
from astropy.time import Time
from astropy.utils import iers

from gss.catalogue_tools.corrections.ephemeris import PLANETS
from gss.catalogue_tools.corrections.exclusions import exclusions, within
from gss.domain.angles import ARCSEC_RAD, separation_rad
from gss.domain.errors import BadInput

START = datetime(2026, 11, 21, tzinfo=UTC)
# The bending of light at the Sun is in astropy's places: 0.25″ for a planet 2° from it.
PLANET_TOLERANCE_RAD = 0.3 * ARCSEC_RAD
MOON_TOLERANCE_RAD = 0.2 * ARCSEC_RAD
RADIUS_TOLERANCE = 0.002


@pytest.fixture(autouse=True)
def _quiet_astropy() -> Iterator[None]:
    """No download of Earth orientation, no warning that it is missing."""
    with iers.conf.set_temp("auto_download", False), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def test_tracks_are_astropys_apparent_places() -> None:
    """Directions at the samples are those that astropy gives for the same UTC, radii follow from its distances."""
    found = exclusions(START, 90, limit_mag=9.0, step_days=30)
    assert [t.name for t in found.tracks] == ["Sun", "Moon", *PLANETS]
    for k in range(len(found.jyear)):
        time = Time(START + timedelta(days=30 * k))
        for track in found.tracks:
            seen = get_body(track.name.lower(), time, ephemeris="builtin").cartesian.xyz.to_value(u.km)
            distance_km = float(np.linalg.norm(seen))
            tolerance = MOON_TOLERANCE_RAD if track.name == "Moon" else PLANET_TOLERANCE_RAD
            assert separation_rad(track.icrs[k], seen / distance_km) < tolerance, track.name
            if track.name == "Moon":
                assert track.radius_rad[k] == pytest.approx(1737.4 / distance_km, rel=RADIUS_TOLERANCE)


def test_venus_crosses_the_sun_in_2012() -> None:
    """On 6 June 2012, 1:30 UTC, Venus was 9′ from the Sun's centre, with a diameter of 58″."""
    found = exclusions(datetime(2012, 6, 5, 22, tzinfo=UTC), 0.3, step_days=0.01)
    sun, venus = found.track("Sun"), found.track("Venus")
    assert sun is not None
    assert venus is not None
    away = separation_rad(sun.icrs, venus.icrs)
    closest = int(np.argmin(away))
    assert away[closest] / ARCSEC_RAD == pytest.approx(554, abs=5)
    assert abs(closest * 0.01 * 24 - 3.5) < 0.3
    assert 2 * venus.radius_rad[closest] / ARCSEC_RAD == pytest.approx(57.8, abs=0.5)


def test_jupiter_meets_saturn_in_2020() -> None:
    """On 21 December 2020 they were 6.1′ apart."""
    found = exclusions(datetime(2020, 12, 1, tzinfo=UTC), 40)
    jupiter, saturn = found.track("Jupiter"), found.track("Saturn")
    assert jupiter is not None
    assert saturn is not None
    away = separation_rad(jupiter.icrs, saturn.icrs)
    at = int(np.argmin(away))
    assert found.jyear[at] == pytest.approx(2020 + 356 / 366, abs=2 / 365)
    assert away[at] / ARCSEC_RAD == pytest.approx(6.1 * 60, abs=60)


def test_magnitudes_are_those_of_almanacs() -> None:
    """During a year Venus reaches −4.6 or brighter, Jupiter to −2.6, the full Moon to −12.7, Uranus stays at 5.6 to 5.9."""
    found = exclusions(START, 400)
    expected = {
        "Venus": (-4.9, -4.5),
        "Jupiter": (-2.8, -2.4),
        "Moon": (-12.95, -12.5),
        "Uranus": (5.4, 5.7),
        "Sun": (-26.8, -26.7),
    }
    for name, (low, high) in expected.items():
        track = found.track(name)
        assert track is not None
        assert low < track.brightest_mag < high, name
    assert found.track("Neptune") is None
    assert exclusions(START, 10, limit_mag=-5.0).track("Venus") is None
    assert exclusions(START, 10, limit_mag=-99.0).track("Moon") is not None


def test_samples_cover_exactly_the_range() -> None:
    """First and last sample are the ends of the range, steps are at most the requested size."""
    found = exclusions(START, 10.5, step_days=1.0)
    days = (found.jyear - found.jyear[0]) * 365.25
    assert days[-1] == pytest.approx(10.5)
    assert np.diff(days).max() <= 1.0 + 1e-6
    assert len(json.dumps(found.as_dict(), allow_nan=False)) > 1000


def test_a_region_is_tested_sample_by_sample() -> None:
    """The envelope's test determines when a body is inside."""
    found = exclusions(START, 30)
    inside = within(found, lambda unit: unit[:, 2] > 0, ("Moon",))
    assert set(inside) == {"Moon"}
    moon = found.track("Moon")
    assert moon is not None
    assert np.array_equal(inside["Moon"], moon.icrs[:, 2] > 0)
    assert 0 < inside["Moon"].sum() < len(found.jyear)


def test_observer_in_orbit_sees_the_moon_elsewhere() -> None:
    """From 7 000 km off the centre the Moon is displaced by up to a degree, within the margin that the geocentric track
    states.
    """
    centre = exclusions(START, 5)
    orbit = exclusions(START, 5, observer_km=np.array([0.0, 0.0, 7000.0]))
    a, b = centre.track("Moon"), orbit.track("Moon")
    assert a is not None
    assert b is not None
    shift = separation_rad(a.icrs, b.icrs)
    assert 0.5 < np.degrees(shift.max()) <= np.degrees(a.margin_rad) * 1.05
    assert b.margin_rad == 0


@pytest.mark.parametrize(
    ("start", "days", "options", "text"),
    [
        (datetime(2026, 1, 1), 10, {}, "no time zone"),
        (START, 0, {}, "date range"),
        (START, 4000, {}, "date range"),
        (START, float("nan"), {}, "date range"),
        (START, 10, {"step_days": 0.0}, "step is out of range"),
        (START, 1000, {"step_days": 0.01}, "step is out of range"),
        (START, 10, {"limit_mag": float("nan")}, "not a number"),
    ],
)
def test_impossible_ranges_are_rejected(start, days, options, text) -> None:  # type: ignore[no-untyped-def]
    """Each error names the field."""
    with pytest.raises(BadInput, match=text):
        exclusions(start, days, **options)

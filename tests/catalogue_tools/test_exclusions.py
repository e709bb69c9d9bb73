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
# Only astropy includes the deflection of light by the Sun, which is 0.25″ for a planet 2° from the Sun.
PLANET_TOLERANCE_RAD = 0.3 * ARCSEC_RAD
MOON_TOLERANCE_RAD = 0.2 * ARCSEC_RAD
RADIUS_TOLERANCE = 0.002


@pytest.fixture(autouse=True)
def _quiet_astropy() -> Iterator[None]:
    """Disable the download of Earth orientation data and the warning that it is missing."""
    with iers.conf.set_temp("auto_download", False), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def test_tracks_agree_with_apparent_positions_of_astropy() -> None:
    """At each sample, the directions agree with astropy's for the same UTC, and the Moon's radius agrees with its
    distance.
    """
    result = exclusions(START, 90, limit_mag=9.0, step_days=30)
    assert [t.name for t in result.tracks] == ["Sun", "Moon", *PLANETS]
    for k in range(len(result.jyear)):
        time = Time(START + timedelta(days=30 * k))
        for track in result.tracks:
            position_km = get_body(track.name.lower(), time, ephemeris="builtin").cartesian.xyz.to_value(u.km)
            distance_km = float(np.linalg.norm(position_km))
            tolerance = MOON_TOLERANCE_RAD if track.name == "Moon" else PLANET_TOLERANCE_RAD
            assert separation_rad(track.icrs[k], position_km / distance_km) < tolerance, track.name
            if track.name == "Moon":
                assert track.radius_rad[k] == pytest.approx(1737.4 / distance_km, rel=RADIUS_TOLERANCE)


def test_transit_of_venus_in_2012_is_reproduced() -> None:
    """On 6 June 2012 at 1:30 UTC, Venus was 9′ from the centre of the Sun, with a diameter of 58″."""
    result = exclusions(datetime(2012, 6, 5, 22, tzinfo=UTC), 0.3, step_days=0.01)
    sun, venus = result.track("Sun"), result.track("Venus")
    assert sun is not None
    assert venus is not None
    separation = separation_rad(sun.icrs, venus.icrs)
    closest = int(np.argmin(separation))
    assert separation[closest] / ARCSEC_RAD == pytest.approx(554, abs=5)
    assert abs(closest * 0.01 * 24 - 3.5) < 0.3
    assert 2 * venus.radius_rad[closest] / ARCSEC_RAD == pytest.approx(57.8, abs=0.5)


def test_conjunction_of_jupiter_and_saturn_in_2020_is_reproduced() -> None:
    """On 21 December 2020, Jupiter and Saturn were 6.1′ apart."""
    result = exclusions(datetime(2020, 12, 1, tzinfo=UTC), 40)
    jupiter, saturn = result.track("Jupiter"), result.track("Saturn")
    assert jupiter is not None
    assert saturn is not None
    separation = separation_rad(jupiter.icrs, saturn.icrs)
    closest = int(np.argmin(separation))
    assert result.jyear[closest] == pytest.approx(2020 + 356 / 366, abs=2 / 365)
    assert separation[closest] / ARCSEC_RAD == pytest.approx(6.1 * 60, abs=60)


def test_magnitudes_agree_with_almanacs() -> None:
    """The brightest magnitudes within a year are those of almanacs: Venus about −4.7, Jupiter −2.6, the full Moon
    −12.7, Uranus 5.6. Bodies fainter than the limit are omitted, except the Moon.
    """
    result = exclusions(START, 400)
    expected = {
        "Venus": (-4.9, -4.5),
        "Jupiter": (-2.8, -2.4),
        "Moon": (-12.95, -12.5),
        "Uranus": (5.4, 5.7),
        "Sun": (-26.8, -26.7),
    }
    for name, (low, high) in expected.items():
        track = result.track(name)
        assert track is not None
        assert low < track.brightest_mag < high, name
    assert result.track("Neptune") is None
    assert exclusions(START, 10, limit_mag=-5.0).track("Venus") is None
    assert exclusions(START, 10, limit_mag=-99.0).track("Moon") is not None


def test_samples_cover_exactly_the_range() -> None:
    """The first and last samples are at the ends of the range, and no step exceeds the requested size."""
    result = exclusions(START, 10.5, step_days=1.0)
    days = (result.jyear - result.jyear[0]) * 365.25
    assert days[-1] == pytest.approx(10.5)
    assert np.diff(days).max() <= 1.0 + 1e-6
    assert len(json.dumps(result.as_dict(), allow_nan=False)) > 1000


def test_the_region_test_is_applied_to_each_sample() -> None:
    """``within`` marks the samples for which the given region test is true."""
    result = exclusions(START, 30)
    inside = within(result, lambda unit: unit[:, 2] > 0, ("Moon",))
    assert set(inside) == {"Moon"}
    moon = result.track("Moon")
    assert moon is not None
    assert np.array_equal(inside["Moon"], moon.icrs[:, 2] > 0)
    assert 0 < inside["Moon"].sum() < len(result.jyear)


def test_parallax_of_an_observer_in_orbit() -> None:
    """For an observer 7 000 km from the Earth's centre, the Moon is displaced by up to one degree. The margin of the
    geocentric track covers this parallax.
    """
    geocentric = exclusions(START, 5)
    orbit = exclusions(START, 5, observer_km=np.array([0.0, 0.0, 7000.0]))
    moon, moon_from_orbit = geocentric.track("Moon"), orbit.track("Moon")
    assert moon is not None
    assert moon_from_orbit is not None
    shift = separation_rad(moon.icrs, moon_from_orbit.icrs)
    assert 0.5 < np.degrees(shift.max()) <= np.degrees(moon.margin_rad) * 1.05
    assert moon_from_orbit.margin_rad == 0


@pytest.mark.parametrize(
    ("start", "days", "options", "message"),
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
def test_invalid_ranges_are_rejected(start, days, options, message) -> None:  # type: ignore[no-untyped-def]
    """Invalid ranges are rejected, and the error names the field."""
    with pytest.raises(BadInput, match=message):
        exclusions(start, days, **options)

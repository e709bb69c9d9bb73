"""Orbital planes from TLEs, compared with positions of sgp4 and with astropy's TEME frame."""

from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from astropy.coordinates import ICRS, TEME, CartesianRepresentation
from astropy.time import Time
from sgp4.api import Satrec, jday

from gss.catalogue_tools.envelope.ellipse import node_rate_rad_s
from gss.catalogue_tools.envelope.orbits import altitude_of_tle, from_tle, jyear_of, read_tle
from gss.domain.angles import separation_rad
from gss.domain.errors import BadInput

# The element set of 2019-12-09 from the documentation of the sgp4 package.
TLE = """ISS (ZARYA)
1 25544U 98067A   19343.69339541  .00001764  00000-0  38792-4 0  9991
2 25544  51.6439 211.2001 0007417  17.6667  85.6398 15.50103472202482
"""
START = datetime(2019, 12, 10, tzinfo=UTC)
PLANE_TOLERANCE_RAD = np.radians(0.1)


def with_checksum(line):
    """Return the TLE line with a valid checksum."""
    total = sum(int(c) if c.isdigit() else c == "-" for c in line[:68]) % 10
    return f"{line[:68]}{total}"


@pytest.mark.parametrize("days", [0.5, 5, 20])
def test_planes_agree_with_sgp4_and_astropy(days):
    """At both ends of the span, the plane agrees within 0.1° with that of SGP4's position and velocity, converted to
    ICRS with astropy.
    """
    planes = from_tle(TLE, START, days)
    satellite = Satrec.twoline2rv(*TLE.strip().splitlines()[1:])
    for time, raan in ((START, planes.raan_start_rad), (START + timedelta(days=days), planes.raan_end_rad)):
        jd, part = jday(time.year, time.month, time.day, time.hour, time.minute, time.second)
        _, position, velocity = satellite.sgp4(jd, part)
        normal = np.cross(position, velocity)
        teme = TEME(CartesianRepresentation(normal / np.linalg.norm(normal)), obstime=Time(jd, part, format="jd"))
        expected = teme.transform_to(ICRS()).cartesian.xyz.value
        expected = expected / np.linalg.norm(expected)
        inclination = np.mean(planes.inclination_rad)
        plane_normal = [np.sin(raan) * np.sin(inclination), -np.cos(raan) * np.sin(inclination), np.cos(inclination)]
        assert separation_rad(np.array(plane_normal), expected) < PLANE_TOLERANCE_RAD


def test_the_node_of_the_station_drifts_west():
    """The station's node regresses by 5° per day, and the closed formula agrees."""
    planes = from_tle(TLE, START, 10)
    drift = np.degrees(planes.raan_end_rad - planes.raan_start_rad) / 10
    assert drift == pytest.approx(-4.97, abs=0.05)
    assert np.degrees(node_rate_rad_s(np.radians(51.64), 417e3)) * 86400 == pytest.approx(drift, rel=0.01)


def test_a_drift_across_zero_gives_a_short_range():
    """A node that passes 0° gives a short range instead of almost a full circle."""
    line = with_checksum(TLE.splitlines()[2].replace("211.2001", "  4.0000"))
    planes = from_tle("\n".join([TLE.splitlines()[1], line]), START, 3)
    assert np.degrees(np.ptp(planes.raan_rad)) == pytest.approx(15, abs=0.5)


def test_the_node_of_a_sun_synchronous_orbit_drifts_east():
    """The node of Jacobs' 97° orbit drifts by about 1° per day to the east."""
    rate = np.degrees(node_rate_rad_s(np.radians(97.0), 600e3)) * 86400
    assert 0.8 < rate < 1.1


@pytest.mark.parametrize(
    ("text", "start", "days", "message"),
    [
        (TLE.replace("9991", "9992"), START, 5, "line 1 has a wrong checksum"),
        (TLE.replace(" 9991", "9991"), START, 5, "wrong length"),
        ("hello", START, 5, "not a two-line element set"),
        ("", START, 5, "not a two-line element set"),
        (TLE, datetime(2021, 1, 1, tzinfo=UTC), 5, "outside the TLE's validity"),
        (TLE, datetime(2019, 11, 1, tzinfo=UTC), 5, "outside the TLE's validity"),
        (TLE, START, 90, "outside the TLE's validity"),
        (TLE, START, 0, "the time span is empty"),
        (TLE, datetime(2019, 12, 10), 5, "no time zone"),
    ],
)
def test_invalid_tles_and_dates_are_rejected(text, start, days, message):
    """A wrong checksum, a wrong length, text that is not a TLE, and dates outside the validity are rejected with a
    clear error.
    """
    with pytest.raises(BadInput, match=message):
        from_tle(text, start, days)


def test_a_decayed_orbit_is_rejected():
    """A satellite that decays within the span is rejected."""
    line = with_checksum(TLE.splitlines()[1].replace("38792-4", "99999-0"))
    second = with_checksum(TLE.splitlines()[2].replace("15.50103472", "16.48000000"))
    with pytest.raises(BadInput, match=r"decayed|no orbit"):
        from_tle(f"{line}\n{second}", START, 40)


def test_lines_of_two_satellites_are_rejected():
    """Line 1 of one satellite with line 2 of another is rejected."""
    second = with_checksum(TLE.splitlines()[2].replace("25544", "25545"))
    with pytest.raises(BadInput, match="different satellites"):
        read_tle("\n".join([TLE.splitlines()[1], second]))


def test_julian_year_agrees_with_astropy():
    """Epochs agree with astropy within about a minute."""
    assert jyear_of(START) == pytest.approx(Time(START).jyear, abs=2e-6)


def test_altitude_of_the_mean_orbit_is_calculated():
    """The station, with 15.501 revolutions per day, has an altitude of about 417 km."""
    assert altitude_of_tle(TLE) == pytest.approx(417e3, abs=5e3)


def test_a_perigee_in_the_atmosphere_is_rejected():
    """A perigee below 100 km is rejected as a decayed orbit, whatever the mean motion, and the error has a hint."""
    low = with_checksum(TLE.splitlines()[2].replace("0007417", "0550000"))
    for use in (read_tle, altitude_of_tle, lambda text: from_tle(text, START, 5)):
        with pytest.raises(BadInput, match="decayed") as error:
            use("\n".join([TLE.splitlines()[1], low]))
        assert error.value.expected
        assert error.value.got
        assert error.value.hint


def test_elements_without_an_orbit_are_rejected():
    """Errors of SGP4 are reported as BadInput with the expected values and a hint."""
    invalid = with_checksum(TLE.splitlines()[2].replace("15.50103472", "99.50103472"))
    with pytest.raises(BadInput) as error:
        read_tle("\n".join([TLE.splitlines()[1], invalid]))
    assert error.value.expected
    assert error.value.hint

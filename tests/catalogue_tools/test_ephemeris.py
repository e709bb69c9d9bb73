"""Sun, Moon and planets, compared with astropy and with worked examples of Meeus, Astronomical Algorithms."""

from __future__ import annotations

import warnings
from collections.abc import Iterator

import astropy.units as u
import erfa
import numpy as np
import pytest
from astropy.coordinates import GCRS, TEME, CartesianRepresentation, SkyCoord, get_body
from astropy.time import Time
from astropy.utils import iers

from gss.catalogue_tools.corrections.corrections import aberrate
from gss.catalogue_tools.corrections.ephemeris import AU_KM, PLANETS, bodies_at, earth_pole_icrs, teme_from_icrs
from gss.domain.angles import ARCSEC_RAD

DATES = ("2024-02-29T06:00:00", "2026-01-01T12:00:00", "2026-06-15T03:00:00")
# Only astropy includes the deflection of light by the Sun, 0.25″ for a planet 2° from it (Mercury in February 2024).
PLANET_TOLERANCE_RAD = 0.3 * ARCSEC_RAD
MOON_TOLERANCE_RAD = 0.1 * ARCSEC_RAD
SUN_TOLERANCE_RAD = 0.05 * ARCSEC_RAD
TEME_TOLERANCE_RAD = 0.1 * ARCSEC_RAD
ABERRATION_TOLERANCE_RAD = 0.01e-3 * ARCSEC_RAD


@pytest.fixture(autouse=True)
def _quiet_astropy() -> Iterator[None]:
    """Disable the download of Earth orientation data and the warning that it is missing."""
    with iers.conf.set_temp("auto_download", False), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def _jyear(time: Time) -> float:
    return float(2000.0 + (time.tt.jd1 - 2451545.0 + time.tt.jd2) / 365.25)


def _apparent_direction(name: str, time: Time) -> np.ndarray:
    """Return astropy's apparent geocentric direction of a body."""
    position_km = get_body(name, time, ephemeris="builtin").cartesian.xyz.to_value(u.km)
    return position_km / np.linalg.norm(position_km)


@pytest.mark.parametrize("date", DATES)
def test_planets_moon_and_sun_agree_with_astropy(date: str) -> None:
    """Geocentric directions, with aberration applied, agree with astropy's apparent positions."""
    time = Time(date, scale="tt")
    bodies = bodies_at(_jyear(time))
    for name, icrs in zip(PLANETS, aberrate(bodies.planets_icrs, bodies.earth_velocity_c), strict=True):
        assert np.linalg.norm(icrs - _apparent_direction(name.lower(), time)) < PLANET_TOLERANCE_RAD, name
    sun, moon = aberrate(np.stack([bodies.sun.icrs, bodies.moon.icrs]), bodies.earth_velocity_c)
    assert np.linalg.norm(sun - _apparent_direction("sun", time)) < SUN_TOLERANCE_RAD
    # The Moon moves with the Earth, so astropy's position contains no annual aberration.
    assert np.linalg.norm(bodies.moon.icrs - _apparent_direction("moon", time)) < MOON_TOLERANCE_RAD
    assert np.linalg.norm(moon - bodies.moon.icrs) < 21 * ARCSEC_RAD


@pytest.mark.parametrize("date", DATES)
def test_aberration_of_stars_agrees_with_astropy(date: str) -> None:
    """Over the sky, the aberration agrees with astropy's within 0.01 mas. The deflection by the Sun, which GSS ignores
    and astropy includes, is added with ERFA.
    """
    time = Time(date, scale="tt")
    bodies = bodies_at(_jyear(time))
    rng = np.random.default_rng(1)
    unit = rng.normal(size=(200, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    unit = unit[unit @ bodies.sun.icrs < 0.9]
    stars = SkyCoord(CartesianRepresentation(unit.T * 1e9 * u.Mpc), frame="icrs")
    expected = stars.transform_to(GCRS(obstime=time)).cartesian.xyz.value.T
    expected /= np.linalg.norm(expected, axis=1, keepdims=True)
    deflected = erfa.ldsun(unit, -bodies.sun.icrs, bodies.sun.distance_km / AU_KM)
    error_rad = np.linalg.norm(aberrate(deflected, bodies.earth_velocity_c) - expected, axis=1)
    assert error_rad.max() < ABERRATION_TOLERANCE_RAD


def test_examples_of_meeus_are_reproduced() -> None:
    """The distance of the Moon agrees with example 47.a, and the magnitude of Venus, −4.2, with example 41.c."""
    moon = bodies_at(_jyear(Time("1992-04-12T00:00:00", scale="tt"))).moon
    assert moon.distance_km == pytest.approx(368_409.7, abs=1.0)
    planets = bodies_at(_jyear(Time("1992-12-20T00:00:00", scale="tt"))).planets_v_mag
    assert planets[PLANETS.index("Venus")] == pytest.approx(-4.2, abs=0.05)


def test_brightness_follows_the_phase() -> None:
    """The full Moon of 3 January 2026 has magnitude −12.8, the new Moon of 18 January is fainter than −5, and the Sun
    has −26.8.
    """
    full_moon = bodies_at(_jyear(Time("2026-01-03T10:00:00", scale="tt")))
    new_moon = bodies_at(_jyear(Time("2026-01-18T20:00:00", scale="tt")))
    assert full_moon.moon.v_mag == pytest.approx(-12.8, abs=0.3)
    assert new_moon.moon.v_mag > -5
    assert full_moon.sun.v_mag == pytest.approx(-26.77, abs=0.05)
    assert np.degrees(full_moon.sun.radius_rad) * 60 == pytest.approx(16.26, abs=0.05)


def test_parallax_in_a_low_orbit_is_included() -> None:
    """Between opposite sides of a 600 km orbit, the direction of the Moon changes by two degrees, and those of planets
    by arcseconds.
    """
    south, north = (bodies_at(2026.0, np.array([0.0, 0.0, z])) for z in (-6978.0, 6978.0))
    parallax_rad = float(np.linalg.norm(south.moon.icrs - north.moon.icrs))
    distance_km = bodies_at(2026.0).moon.distance_km
    sine_of_angle = np.sqrt(1 - south.moon.icrs[2] ** 2)
    assert parallax_rad == pytest.approx(2 * 6978.0 / distance_km * sine_of_angle, rel=0.02)
    assert np.linalg.norm(south.planets_icrs - north.planets_icrs, axis=1).max() < 2 * 6978 / (0.26 * AU_KM)


def test_teme_axes_and_the_pole_are_correct() -> None:
    """The axes of TEME agree with astropy's, and the pole moves by the precession of 20″ per year."""
    time = Time("2026-06-15T03:00:00", scale="tt")
    vectors = np.random.default_rng(2).normal(size=(3, 5))
    expected = TEME(CartesianRepresentation(vectors * u.km), obstime=time).transform_to(GCRS(obstime=time))
    in_icrs = teme_from_icrs(_jyear(time)).T @ vectors
    assert np.linalg.norm(in_icrs - expected.cartesian.xyz.to_value(u.km), axis=0) == pytest.approx(
        0, abs=TEME_TOLERANCE_RAD * float(np.linalg.norm(vectors, axis=0).max())
    )
    moved_arcsec = float(np.linalg.norm(earth_pole_icrs(2026.0)[:2])) / ARCSEC_RAD
    assert moved_arcsec == pytest.approx(26 * 20.04, abs=12)

"""Sun, Moon and planets against astropy and against the worked examples of a book."""

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
# The light's bending at the Sun, which astropy adds, is 0.25″ for a planet 2° from it (Mercury in February 2024).
PLANET_TOLERANCE_RAD = 0.3 * ARCSEC_RAD
MOON_TOLERANCE_RAD = 0.1 * ARCSEC_RAD
SUN_TOLERANCE_RAD = 0.05 * ARCSEC_RAD
TEME_TOLERANCE_RAD = 0.1 * ARCSEC_RAD
ABERRATION_TOLERANCE_RAD = 0.01e-3 * ARCSEC_RAD


@pytest.fixture(autouse=True)
def _quiet_astropy() -> Iterator[None]:
    """No download of Earth orientation, no warning that it is missing."""
    with iers.conf.set_temp("auto_download", False), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        yield


def _jyear(time: Time) -> float:
    return float(2000.0 + (time.tt.jd1 - 2451545.0 + time.tt.jd2) / 365.25)


def _seen(name: str, time: Time) -> np.ndarray:
    place = get_body(name, time, ephemeris="builtin").cartesian.xyz.to_value(u.km)
    return place / np.linalg.norm(place)


@pytest.mark.parametrize("date", DATES)
def test_planets_moon_and_sun_agree_with_astropy(date: str) -> None:
    """Directions from the Earth's centre, with our aberration applied, agree with astropy's apparent positions."""
    time = Time(date, scale="tt")
    bodies = bodies_at(_jyear(time))
    for name, icrs in zip(PLANETS, aberrate(bodies.planets_icrs, bodies.earth_velocity_c), strict=True):
        assert np.linalg.norm(icrs - _seen(name.lower(), time)) < PLANET_TOLERANCE_RAD, name
    sun, moon = aberrate(np.stack([bodies.sun.icrs, bodies.moon.icrs]), bodies.earth_velocity_c)
    assert np.linalg.norm(sun - _seen("sun", time)) < SUN_TOLERANCE_RAD
    # The Moon shares the Earth's motion: astropy's place holds no annual aberration.
    assert np.linalg.norm(bodies.moon.icrs - _seen("moon", time)) < MOON_TOLERANCE_RAD
    assert np.linalg.norm(moon - bodies.moon.icrs) < 21 * ARCSEC_RAD


@pytest.mark.parametrize("date", DATES)
def test_stars_are_displaced_as_astropy_displaces_them(date: str) -> None:
    """Aberration by our velocity of the Earth is astropy's to 0.01 mas all over the sky, once the light's bending at the
    Sun, which no star tracker sees, is added by ERFA."""
    time = Time(date, scale="tt")
    bodies = bodies_at(_jyear(time))
    rng = np.random.default_rng(1)
    unit = rng.normal(size=(200, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    unit = unit[unit @ bodies.sun.icrs < 0.9]
    stars = SkyCoord(CartesianRepresentation(unit.T * 1e9 * u.Mpc), frame="icrs")
    theirs = stars.transform_to(GCRS(obstime=time)).cartesian.xyz.value.T
    theirs /= np.linalg.norm(theirs, axis=1, keepdims=True)
    bent = erfa.ldsun(unit, -bodies.sun.icrs, bodies.sun.distance_km / AU_KM)
    error_rad = np.linalg.norm(aberrate(bent, bodies.earth_velocity_c) - theirs, axis=1)
    assert error_rad.max() < ABERRATION_TOLERANCE_RAD


def test_the_moon_and_venus_of_meeus() -> None:
    """Astronomical Algorithms, examples 47.a (the Moon's distance) and 41.c (Venus of magnitude −4.2)."""
    moon = bodies_at(_jyear(Time("1992-04-12T00:00:00", scale="tt"))).moon
    assert moon.distance_km == pytest.approx(368_409.7, abs=1.0)
    planets = bodies_at(_jyear(Time("1992-12-20T00:00:00", scale="tt"))).planets_v_mag
    assert planets[PLANETS.index("Venus")] == pytest.approx(-4.2, abs=0.05)


def test_brightness_follows_the_phase() -> None:
    """The full Moon of 3 January 2026 has about −12.7, the new Moon of 18 January hardly shines; the Sun has −26.7."""
    full = bodies_at(_jyear(Time("2026-01-03T10:00:00", scale="tt")))
    new = bodies_at(_jyear(Time("2026-01-18T20:00:00", scale="tt")))
    assert full.moon.v_mag == pytest.approx(-12.8, abs=0.3)
    assert new.moon.v_mag > -5
    assert full.sun.v_mag == pytest.approx(-26.77, abs=0.05)
    assert np.degrees(full.sun.radius_rad) * 60 == pytest.approx(16.26, abs=0.05)


def test_a_low_orbit_sees_the_moon_elsewhere() -> None:
    """From one side of a 600 km orbit to the other the Moon moves by two degrees, the planets by arcseconds."""
    left, right = (bodies_at(2026.0, np.array([0.0, 0.0, z])) for z in (-6978.0, 6978.0))
    apart_rad = float(np.linalg.norm(left.moon.icrs - right.moon.icrs))
    distance_km = bodies_at(2026.0).moon.distance_km
    across = np.sqrt(1 - left.moon.icrs[2] ** 2)
    assert apart_rad == pytest.approx(2 * 6978.0 / distance_km * across, rel=0.02)
    assert np.linalg.norm(left.planets_icrs - right.planets_icrs, axis=1).max() < 2 * 6978 / (0.26 * AU_KM)


def test_axes_of_sgp4_and_the_pole_are_astropys() -> None:
    """TEME against astropy; the pole has moved by precession 20″ a year."""
    time = Time("2026-06-15T03:00:00", scale="tt")
    given = np.random.default_rng(2).normal(size=(3, 5))
    there = TEME(CartesianRepresentation(given * u.km), obstime=time).transform_to(GCRS(obstime=time))
    ours = teme_from_icrs(_jyear(time)).T @ given
    assert np.linalg.norm(ours - there.cartesian.xyz.to_value(u.km), axis=0) == pytest.approx(
        0, abs=TEME_TOLERANCE_RAD * float(np.linalg.norm(given, axis=0).max())
    )
    moved_arcsec = float(np.linalg.norm(earth_pole_icrs(2026.0)[:2])) / ARCSEC_RAD
    assert moved_arcsec == pytest.approx(26 * 20.04, abs=12)

"""Aberration, the Sun's longitude and precession, compared with astropy and ERFA."""

import erfa
import numpy as np
import pytest
from astropy.coordinates import get_body_barycentric
from astropy.time import Time

from gss.catalogue_tools.corrections.corrections import (
    ICRS_FROM_ECLIPTIC,
    aberrate,
    date_from_icrs,
    sun_longitude_rad,
)
from gss.catalogue_tools.corrections.ephemeris import bodies_at
from gss.domain.angles import ARCSEC_RAD, separation_rad

SUN_TOLERANCE_RAD = np.radians(0.01)
YEARS = [1983.0, 1995.3, 2013.77, 2026.9, 2049.1]


def tdb(jyear):
    return Time(jyear, format="jyear", scale="tdb")


def on_ecliptic(longitude_rad):
    """Return (…, 3) ICRS unit vectors on the ecliptic of J2000."""
    x, y = np.cos(longitude_rad), np.sin(longitude_rad)
    return np.stack([x, y, np.zeros_like(x)], axis=-1) @ ICRS_FROM_ECLIPTIC.T


@pytest.mark.parametrize("jyear", YEARS)
def test_sun_agrees_with_the_ephemeris(jyear):
    """The Sun's direction agrees with astropy's within 0.01°."""
    sun = get_body_barycentric("sun", tdb(jyear), ephemeris="builtin").xyz.value
    earth = get_body_barycentric("earth", tdb(jyear), ephemeris="builtin").xyz.value
    expected = (sun - earth) / np.linalg.norm(sun - earth)
    direction = on_ecliptic(sun_longitude_rad(jyear))
    assert separation_rad(direction, expected) < SUN_TOLERANCE_RAD


def test_aberration_agrees_with_erfa():
    """Apparent directions over the whole sky agree with ERFA's within a microarcsecond."""
    rng = np.random.default_rng(3)
    unit = rng.normal(size=(200, 3))
    unit /= np.linalg.norm(unit, axis=1, keepdims=True)
    velocity = bodies_at(2026.9).earth_velocity_c
    inverse_gamma = np.sqrt(1 - velocity @ velocity)
    # The observer is far from the Sun, because ERFA would otherwise add half a microarcsecond for the Sun's potential.
    expected = erfa.ab(unit, velocity, 1e12, inverse_gamma)
    assert separation_rad(aberrate(unit, velocity), expected).max() < 1e-6 * ARCSEC_RAD


def test_aberration_is_at_most_twenty_and_a_half_arcseconds():
    """The largest shift over the sky is the constant of aberration, 20.5″."""
    unit = np.concatenate([np.eye(3), -np.eye(3)])
    grid = on_ecliptic(np.linspace(0, 2 * np.pi, 721))
    velocity = bodies_at(2026.9).earth_velocity_c
    shift = separation_rad(aberrate(np.concatenate([unit, grid]), velocity), np.concatenate([unit, grid])) / ARCSEC_RAD
    assert 20.1 < shift.max() < 20.9


@pytest.mark.parametrize("jyear", YEARS)
def test_precession_agrees_with_erfa(jyear):
    """The rotation to the mean axes of date, including bias, is that of IAU 2006."""
    expected = erfa.pmat06(tdb(jyear).jd1, tdb(jyear).jd2)
    assert np.abs(date_from_icrs(jyear) - expected).max() < 1e-13

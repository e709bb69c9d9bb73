"""Apparent directions: annual aberration, the Sun's longitude, and the axes of date (Jacobs 1995 §7.5, Moniteq 1983
§2.4).

All formulae are in closed form and need no ephemeris file. Tests compare them with astropy. Time is Terrestrial Time as
a Julian year. It differs from UTC by about a minute, which changes every result by less than a milliarcsecond.
"""

from __future__ import annotations

import numpy as np

from gss.domain.aberration import aberrate as aberrate
from gss.domain.angles import ARCSEC_RAD, Array
from gss.domain.rotation import rotation_x, rotation_z

J2000_JYEAR = 2000.0
DAYS_PER_YEAR = 365.25
OBLIQUITY_J2000_RAD = 84381.406 * ARCSEC_RAD
# Longitude drift of the axes of date relative to those of J2000, rad per year.
GENERAL_PRECESSION_RAD_YR = 50.28796 * ARCSEC_RAD
ICRS_FROM_ECLIPTIC = rotation_x(-OBLIQUITY_J2000_RAD)


def sun_longitude_rad(jyear: float) -> float:
    """Ecliptic longitude of the Sun in J2000 axes, not wrapped, accurate to 0.01° for 1950–2050 (Astronomical
    Almanac C5)."""
    days = (jyear - J2000_JYEAR) * DAYS_PER_YEAR
    anomaly_rad = np.radians(357.528 + 0.9856003 * days)
    of_date_deg = 280.460 + 0.9856474 * days + 1.915 * np.sin(anomaly_rad) + 0.020 * np.sin(2 * anomaly_rad)
    return float(np.radians(of_date_deg) - GENERAL_PRECESSION_RAD_YR * (jyear - J2000_JYEAR))


def parallactic(unit: Array, parallax_rad: Array, observer_au: Array) -> Array:
    """Return the (n, 3) directions seen from ``observer_au`` (3,), given (n, 3) barycentric directions. Negative
    parallaxes are measurement noise and are treated as zero."""
    shift = np.maximum(np.asarray(parallax_rad), 0.0)[..., None] * np.asarray(observer_au)
    direction = np.asarray(unit) - shift
    return np.asarray(direction / np.linalg.norm(direction, axis=-1, keepdims=True))


def crossing_velocity_km_s(unit: Array, speed_km_s: float, normal: Array, boresight_orbit: Array) -> Array:
    """Return the (n, 3) orbital velocity at the time each of (n, 3) stars crosses the middle of a field fixed in the
    orbit frame.

    ``normal``: (3,) pole of a circular orbit, in the sense of the motion. ``boresight_orbit``: (3,) boresight in the
    axes of docs/conventions.md (+x along the velocity, +z to nadir). If the boresight or the star is at the pole, the
    crossing time is undefined. The result is then zero, which is the mean over the revolution.
    """
    pole = np.asarray(normal, float) / np.linalg.norm(normal)
    ahead, _, down = boresight_orbit
    in_plane = unit - np.outer(unit @ pole, pole)
    length = np.linalg.norm(in_plane, axis=-1, keepdims=True)
    radius = np.hypot(ahead, down)
    if radius < 1e-9:
        return np.zeros_like(unit)
    # In the orbit frame, +x points along the velocity and −z points to the zenith. In the orbit plane, the velocity is
    # 90° ahead of the zenith.
    towards = in_plane / np.where(length > 1e-9, length, np.inf)
    across = np.cross(pole, towards)
    return np.asarray(speed_km_s * (ahead * towards - down * across) / radius)


def date_from_icrs(jyear: float) -> Array:
    """Return the (3, 3) rotation from ICRS to the mean equator and equinox of date: IAU 2006 precession with frame bias
    (Fukushima–Williams angles, Hilton et al. 2006)."""
    t = (jyear - J2000_JYEAR) / 100

    def angle_rad(*arcsec: float) -> float:
        return float(np.polyval(arcsec, t)) * ARCSEC_RAD

    gamma = angle_rad(2.60e-8, -2.788e-6, -3.1238e-4, 0.4932044, 10.556378, -0.052928)
    phi = angle_rad(-1.76e-8, -4.40e-7, 5.3289e-4, 0.0511268, -46.811016, 84381.412819)
    psi = angle_rad(-1.48e-8, -2.6452e-5, -1.8522e-4, 1.5584175, 5038.481484, -0.041775)
    obliquity = angle_rad(-4.34e-8, -5.76e-7, 2.0034e-3, -1.831e-4, -46.836769, 84381.406)
    rotation: Array = rotation_x(-obliquity) @ rotation_z(-psi) @ rotation_x(phi) @ rotation_z(gamma)
    return rotation

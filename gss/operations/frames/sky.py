"""Directions of Sun and Moon for charts."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import UTC, datetime

import numpy as np

from gss.domain.angles import Array

J2000 = datetime(2000, 1, 1, 12, tzinfo=UTC)
OBLIQUITY_RAD = np.radians(23.4393)
SUN_EXCLUSION_RAD = np.radians(40.0)
MOON_EXCLUSION_RAD = np.radians(20.0)


@dataclass(frozen=True)
class Body:
    """A body in a chart. ``icrs``: geocentric direction. ``exclusion_rad``: minimum angle to the boresight."""

    name: str
    icrs: Array
    exclusion_rad: float


def bodies(at: datetime) -> list[Body]:
    """Return Sun and Moon, accurate to 0.02° and 0.4° (Astronomical Almanac, low precision). This is sufficient only for charts
    and alarms."""
    days = (at - J2000).total_seconds() / 86400
    return [Body("Sun", _sun(days), SUN_EXCLUSION_RAD), Body("Moon", _moon(days), MOON_EXCLUSION_RAD)]


def _sun(days: float) -> Array:
    g = np.radians(357.529 + 0.98560028 * days)
    longitude = np.radians(280.459 + 0.98564736 * days + 1.915 * np.sin(g) + 0.020 * np.sin(2 * g))
    return _equatorial(longitude - _precession_rad(days), 0.0)


def _moon(days: float) -> Array:
    t = days / 36525

    def s(a: float, b: float) -> float:
        return float(np.sin(np.radians(a + b * t)))

    longitude_deg = 218.32 + 481267.881 * t + 6.29 * s(135.0, 477198.87) - 1.27 * s(259.3, -413335.36)
    longitude_deg += (
        0.66 * s(235.7, 890534.22) + 0.21 * s(269.9, 954397.74) - 0.19 * s(357.5, 35999.05) - 0.11 * s(186.5, 966404.03)
    )
    latitude_deg = (
        5.13 * s(93.3, 483202.02) + 0.28 * s(228.2, 960400.89) - 0.28 * s(318.3, 6003.15) - 0.17 * s(217.6, -407332.21)
    )
    return _equatorial(np.radians(longitude_deg) - _precession_rad(days), np.radians(latitude_deg))


def _precession_rad(days: float) -> float:
    """Return the motion of the equinox along the ecliptic since J2000."""
    return float(np.radians(1.3969713) * days / 36525)


def _equatorial(longitude_rad: float, latitude_rad: float) -> Array:
    x = np.cos(latitude_rad) * np.cos(longitude_rad)
    y = np.cos(latitude_rad) * np.sin(longitude_rad)
    z = np.sin(latitude_rad)
    c, s = np.cos(OBLIQUITY_RAD), np.sin(OBLIQUITY_RAD)
    return np.array([x, c * y - s * z, s * y + c * z])

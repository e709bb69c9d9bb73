"""Eccentric orbits: position by time, and the drift of node and perigee (Moniteq 1983 §2.3, §2.5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss.domain.angles import Array
from gss.domain.errors import BadInput

EARTH_RADIUS_M = 6_378_137.0
EARTH_MU_M3_S2 = 3.986004418e14
J2 = 1.08262668e-3
# Minimum altitude. A lower satellite does not complete an orbit.
MIN_ORBIT_M = 100e3
ITERATIONS = 50
CONVERGED_RAD = 1e-14


@dataclass(frozen=True)
class Ellipse:
    """Shape of an eccentric orbit. ``altitude_m``: semi-major axis minus the Earth's equatorial radius. The argument of
    perigee moves uniformly from ``perigee_start_rad`` to ``perigee_end_rad`` during the validity."""

    eccentricity: float
    altitude_m: float
    perigee_start_rad: float
    perigee_end_rad: float

    def __post_init__(self) -> None:
        check_ellipse(self.eccentricity, self.altitude_m)

    def latitude_at(self, part: Array, turn: Array) -> tuple[Array, Array]:
        """Return the (n,) arguments of latitude, and the (n,) distances from the Earth's centre in m, after (n,) parts of the
        validity. ``turn``: (n,) fraction of an orbit since perigee, in time."""
        anomaly = true_anomaly_rad(2 * np.pi * np.asarray(turn), self.eccentricity)
        perigee = self.perigee_start_rad + (self.perigee_end_rad - self.perigee_start_rad) * np.asarray(part)
        semi_m, e = EARTH_RADIUS_M + self.altitude_m, self.eccentricity
        return perigee + anomaly, semi_m * (1 - e * e) / (1 + e * np.cos(anomaly))

    @property
    def apogee_altitude_m(self) -> float:
        """Altitude of the apogee above the equatorial radius."""
        return (EARTH_RADIUS_M + self.altitude_m) * (1 + self.eccentricity) - EARTH_RADIUS_M


def check_ellipse(eccentricity: float, altitude_m: float) -> None:
    """Raise BadInput unless the orbit is an ellipse with its perigee above the atmosphere."""
    if not 0 <= eccentricity < 1:
        raise BadInput("eccentricity is out of range", expected="0 to below 1", got=f"{eccentricity:g}")
    perigee_m = (EARTH_RADIUS_M + altitude_m) * (1 - eccentricity) - EARTH_RADIUS_M
    if perigee_m < MIN_ORBIT_M:
        raise BadInput(
            "the perigee is too low for an orbit",
            expected=f"{MIN_ORBIT_M / 1e3:g} km or more",
            got=f"{perigee_m / 1e3:.0f} km",
            hint="the altitude of an eccentric orbit is its semi-major axis minus 6378 km",
        )


def true_anomaly_rad(mean_rad: Array, eccentricity: float) -> Array:
    """Return (n,) true anomalies of (n,) mean anomalies. Kepler's equation is solved by Newton's method (Moniteq 1983 §2.3)."""
    mean = np.asarray(mean_rad, float)
    turns = np.round(mean / (2 * np.pi)) * 2 * np.pi
    m = mean - turns
    # This start is above the solution for m > 0, from where Newton's method converges without overshoot.
    anomaly = m + 0.85 * eccentricity * np.sign(m)
    for _ in range(ITERATIONS):
        step = (anomaly - eccentricity * np.sin(anomaly) - m) / (1 - eccentricity * np.cos(anomaly))
        anomaly = anomaly - step
        if np.abs(step).max(initial=0.0) < CONVERGED_RAD:
            break
    half = anomaly / 2
    sine, cosine = np.sqrt(1 + eccentricity) * np.sin(half), np.sqrt(1 - eccentricity) * np.cos(half)
    return np.asarray(2 * np.arctan2(sine, cosine) + turns)


def node_rate_rad_s(inclination_rad: float, altitude_m: float, eccentricity: float = 0.0) -> float:
    """Drift of the node due to the Earth's oblateness (Moniteq 1983 §2.5). ``altitude_m``: semi-major axis minus the Earth's
    radius."""
    return -1.5 * _oblateness_rad_s(altitude_m, eccentricity) * float(np.cos(inclination_rad))


def perigee_rate_rad_s(inclination_rad: float, altitude_m: float, eccentricity: float) -> float:
    """Drift of the argument of perigee due to the Earth's oblateness (Moniteq 1983 §2.5); zero at 63.4° and 116.6°."""
    cosine = float(np.cos(inclination_rad))
    return 0.75 * _oblateness_rad_s(altitude_m, eccentricity) * (5 * cosine**2 - 1)


def _oblateness_rad_s(altitude_m: float, eccentricity: float) -> float:
    """J2 times the mean motion, for an ellipse: (R/a)^3.5 (1 − e²)^−2 of the document."""
    semi_m = EARTH_RADIUS_M + altitude_m
    mean_motion = float(np.sqrt(EARTH_MU_M3_S2 / semi_m**3))
    return J2 * mean_motion * (EARTH_RADIUS_M / semi_m) ** 2 / (1 - eccentricity**2) ** 2

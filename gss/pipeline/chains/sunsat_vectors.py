"""Output of Sunsat's star sensor to the attitude control: matched vectors, corrected for aberration (Jacobs 1995 §3.4,
§4.1.7, §7.5). Aberration includes the velocity of the satellite around the Earth and of the Earth around the Sun."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss.domain.angles import Array
from gss.domain.results import SolveResult
from gss.domain.rotation import rotation_x
from gss.domain.stars import Ids
from gss.pipeline.chains.sunsat_frames import BODY_FROM_CAM, OrbitElements, euler_123

LIGHT_M_S = 299_792_458.0
# Speed of a circular orbit at 700 km as rounded in Jacobs 1995 eq. 7.6.
SATELLITE_M_S = 7400.0
# Mean elements of the Earth–Moon barycentre in the ecliptic of J2000, degrees and degrees per Julian century (Standish).
MEAN_LONGITUDE_DEG = (100.46457166, 35999.37244981)
PERIHELION_DEG = (102.93768193, 0.32327364)
ECCENTRICITY = (0.01671123, -0.00004392)
# 2πa over the sidereal year, and the obliquity of J2000.
EARTH_M_S = 29_784.69
OBLIQUITY_RAD = float(np.radians(23.43929111))


@dataclass(frozen=True)
class MatchedVectors:
    """k pairs of unit vectors, (k, 3) each. ``observed_body``: measured stars in body axes; ``reference_orbit``: the
    same catalogue stars in orbit axes, with aberration applied. ``observed_orbit``: the measured stars rotated by the
    given roll, pitch and yaw (eq. 3.4); they agree with the reference if these angles are correct."""

    hip: Ids
    observed_body: Array
    reference_orbit: Array
    observed_orbit: Array

    def __len__(self) -> int:
        return len(self.observed_body)


def matched_vectors(
    result: SolveResult,
    orbit: OrbitElements,
    roll_pitch_yaw_rad: tuple[float, float, float],
    days_since_j2000: float,
    satellite_m_s: float = SATELLITE_M_S,
) -> MatchedVectors:
    """Return the vectors of a solution. Without a solution, return an empty set; the document sends zero in this case.
    Stars that TRIAD did not use are included, because the filter of the attitude control determines the weights. The
    catalogue directions are computed from the residuals without loss of precision.
    """
    if result.attitude is None or result.matches is None:
        nothing = np.empty((0, 3))
        return MatchedVectors(np.empty(0, np.int32), nothing, nothing, nothing)
    m = result.matches
    pixels = result.centroids.pixels[m.centroid]
    body = result.camera.unproject(pixels) @ BODY_FROM_CAM.T
    icrs = result.camera.unproject(pixels - m.residual_px) @ result.attitude.cam_from_icrs
    velocity = velocity_orbit_m_s(orbit, days_since_j2000, satellite_m_s)
    reference = aberrated(icrs @ orbit.orbit_from_icrs.T, velocity)
    return MatchedVectors(m.hip, body, reference, body @ euler_123(*roll_pitch_yaw_rad))


def velocity_orbit_m_s(orbit: OrbitElements, days_since_j2000: float, satellite_m_s: float = SATELLITE_M_S) -> Array:
    """Return the (3,) velocity of the satellite relative to the Sun in orbit axes (eq. 7.5–7.11)."""
    earth = orbit.orbit_from_icrs @ earth_velocity_m_s(days_since_j2000)
    return np.asarray(np.array([satellite_m_s, 0.0, 0.0]) + earth)


def earth_velocity_m_s(days_since_j2000: float) -> Array:
    """Return the (3,) velocity of the Earth around the Sun, in ICRS axes.

    The document uses a circular orbit (eq. 7.9–7.10). Here the orbit is an ellipse, whose hodograph is a circle with
    its centre shifted by the eccentricity. The motion of the Sun and the perturbation by the Moon are neglected. The
    result is therefore accurate to 30 m/s, or 0.02″.
    """
    century = days_since_j2000 / 36525.0
    longitude, perihelion = (np.radians(a + b * century) for a, b in (MEAN_LONGITUDE_DEG, PERIHELION_DEG))
    e = ECCENTRICITY[0] + ECCENTRICITY[1] * century
    anomaly = longitude - perihelion
    true = longitude + (2 * e - e**3 / 4) * np.sin(anomaly) + 1.25 * e**2 * np.sin(2 * anomaly)
    speed = EARTH_M_S / np.sqrt(1 - e * e)
    across = np.array([-np.sin(true) - e * np.sin(perihelion), np.cos(true) + e * np.cos(perihelion), 0.0])
    return np.asarray(speed * (rotation_x(-OBLIQUITY_RAD) @ across))


def aberrated(unit: Array, velocity_m_s: Array) -> Array:
    """Return (n, 3) directions as seen by a moving observer: rotated towards the velocity by arcsin(v/c · sin a) (eq.
    7.2, 7.22).

    The component of the velocity perpendicular to the line of sight is used. Eq. 7.14 divides by the wrong product
    (errata).
    """
    u = np.asarray(unit, float)
    beta = np.asarray(velocity_m_s, float) / LIGHT_M_S
    across = beta - (u @ beta)[:, None] * u
    sine2 = np.sum(across * across, axis=1, keepdims=True)
    return np.asarray(u * np.sqrt(1 - sine2) + across)

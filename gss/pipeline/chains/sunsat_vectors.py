"""What Sunsat's star sensor hands to the attitude control: matching vectors, corrected for aberration (Jacobs 1995 §3.4,
§4.1.7, §7.5). Both velocities that matter are worked out here: the satellite's round the Earth, the Earth's round the Sun."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss.domain.angles import Array
from gss.domain.results import SolveResult
from gss.domain.rotation import rotation_x
from gss.domain.stars import Ids
from gss.pipeline.chains.sunsat_frames import BODY_FROM_CAM, OrbitElements, euler_123

LIGHT_M_S = 299_792_458.0
# Jacobs 1995 eq. 7.6 rounds the speed of a circular orbit of 700 km to this.
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
    """k pairs. (k, 3) unit vectors: ``observed_body`` of the measured stars in body axes, ``reference_orbit`` of the same
    catalogue stars in orbit axes, shifted by aberration to where they are seen. ``observed_orbit``: the measured ones
    turned by the given roll, pitch and yaw (eq. 3.4), which lie on the reference as well as these angles are right."""

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
    """The vectors of a solution; none where there is none, as the document sends a zero. Stars that TRIAD left out go along:
    the control's filter weighs them itself.

    Catalogue directions are found again from the residuals, in which the chain left them exactly.
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
    """(3,) velocity of the satellite against the Sun in orbit axes (eq. 7.5–7.11)."""
    earth = orbit.orbit_from_icrs @ earth_velocity_m_s(days_since_j2000)
    return np.asarray(np.array([satellite_m_s, 0.0, 0.0]) + earth)


def earth_velocity_m_s(days_since_j2000: float) -> Array:
    """(3,) velocity of the Earth round the Sun, ICRS axes.

    The document takes a circle (eq. 7.9–7.10); this is the ellipse, whose velocity is a circle with its centre moved by
    the eccentricity. Good to 30 m/s, which is 0.02″: the Sun's own motion and the Moon's pull are left out.
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
    """(n, 3) directions as seen by an observer with that velocity: turned towards it by arcsin(v/c · sin a) (eq. 7.2, 7.22).

    Written with the part of the velocity across the line of sight; eq. 7.14 divides by the wrong product (errata).
    """
    u = np.asarray(unit, float)
    beta = np.asarray(velocity_m_s, float) / LIGHT_M_S
    across = beta - (u @ beta)[:, None] * u
    sine2 = np.sum(across * across, axis=1, keepdims=True)
    return np.asarray(u * np.sqrt(1 - sine2) + across)

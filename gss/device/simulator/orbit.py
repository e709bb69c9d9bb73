"""Where the camera points: attitude and rate at any time, closed form, so that a time names a picture."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from gss.domain.angles import Array
from gss.domain.frames import cam_from_icrs, orbit_from_icrs
from gss.domain.rotation import rotation_from_vector

EARTH_MU_KM3_S2 = 398_600.4418
EARTH_RADIUS_KM = 6378.137

# Camera looks to the zenith of an Earth-pointing satellite; its columns run along the velocity.
CAM_FROM_ORBIT = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])


@dataclass(frozen=True)
class Pose:
    """(3, 3) cam_from_icrs and (3,) angular velocity against ICRS in camera axes."""

    cam_from_icrs: Array
    rate_rad_s: Array


class Motion(Protocol):
    """The camera's attitude as a function of time."""

    def at(self, time_s: float) -> Pose: ...


@dataclass(frozen=True)
class Inertial:
    """Points at one place, or turns about a fixed camera axis from there: ``rate_rad_s`` (3,) in camera axes."""

    start: Array
    rate_rad_s: Array

    @classmethod
    def pointing(
        cls, ra_rad: float, dec_rad: float, roll_rad: float, rate_rad_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ) -> Inertial:
        """From a boresight and roll."""
        return cls(cam_from_icrs(ra_rad, dec_rad, roll_rad), np.array(rate_rad_s, float))

    def at(self, time_s: float) -> Pose:
        turned = rotation_from_vector(-self.rate_rad_s * time_s)
        return Pose(turned @ self.start, self.rate_rad_s)


@dataclass(frozen=True)
class Zenith:
    """Earth-pointing satellite on a circular orbit, camera to the zenith. No drift of the node, no aberration.

    The default node puts the camera on Orion at the start, where the sky is easy."""

    altitude_km: float = 600.0
    inclination_rad: float = float(np.radians(97.8))
    raan_rad: float = float(np.radians(84.0))
    start_rad: float = 0.0

    @property
    def mean_motion_rad_s(self) -> float:
        """Kepler's third law."""
        return float(np.sqrt(EARTH_MU_KM3_S2 / (EARTH_RADIUS_KM + self.altitude_km) ** 3))

    def at(self, time_s: float) -> Pose:
        latitude_rad = self.start_rad + self.mean_motion_rad_s * time_s
        orbit = orbit_from_icrs(self.raan_rad, self.inclination_rad, latitude_rad)
        # The orbit frame turns about the orbit normal, which is its −y axis.
        rate_orbit = np.array([0.0, -self.mean_motion_rad_s, 0.0])
        return Pose(CAM_FROM_ORBIT @ orbit, CAM_FROM_ORBIT @ rate_orbit)

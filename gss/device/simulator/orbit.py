"""Position and attitude of the camera as closed-form functions of time. The time alone thus determines the scene.

Times are simulated seconds. Further attitude motions are in ``motion``.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from sgp4.api import Satrec

from gss.catalogue_tools.corrections.ephemeris import DAY_S, J2000_JD, TT_MINUS_UTC_S, teme_from_icrs
from gss.catalogue_tools.envelope.orbits import SGP4_WORDS, TLE_VALID_DAYS, read_tle
from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.domain.frames import cam_from_icrs, orbit_from_icrs
from gss.domain.rotation import rotation_from_vector

EARTH_MU_KM3_S2 = 398_600.4418
EARTH_RADIUS_KM = 6378.137
EARTH_TURN_RAD_S = 7.292115e-5
DAYS_PER_YEAR = 365.25

# The camera of an Earth-pointing satellite points to the zenith; its columns run along the velocity.
CAM_FROM_ORBIT = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])


@dataclass(frozen=True)
class Pose:
    """(3, 3) cam_from_icrs and (3,) angular velocity relative to ICRS in camera axes."""

    cam_from_icrs: Array
    rate_rad_s: Array


class Motion(Protocol):
    """The camera's attitude as a function of time."""

    def at(self, time_s: float) -> Pose: ...


class Orbit(Protocol):
    """The camera's position: ((3,) km, (3,) km/s) from the Earth's centre in ICRS axes. ``grounded``: on the Earth's
    surface."""

    @property
    def grounded(self) -> bool: ...

    def state(self, time_s: float) -> tuple[Array, Array]: ...


@dataclass(frozen=True)
class CircularOrbit:
    """A circular orbit from its elements in ICRS axes, without nodal precession."""

    altitude_km: float = 600.0
    inclination_rad: float = float(np.radians(97.8))
    raan_rad: float = float(np.radians(84.0))
    start_rad: float = 0.0
    grounded: bool = False

    @property
    def mean_motion_rad_s(self) -> float:
        """Mean motion in rad/s, from Kepler's third law."""
        return float(np.sqrt(EARTH_MU_KM3_S2 / (EARTH_RADIUS_KM + self.altitude_km) ** 3))

    def state(self, time_s: float) -> tuple[Array, Array]:
        rate, radius_km = self.mean_motion_rad_s, EARTH_RADIUS_KM + self.altitude_km
        axes = orbit_from_icrs(self.raan_rad, self.inclination_rad, self.start_rad + rate * time_s)
        return -axes[2] * radius_km, axes[0] * radius_km * rate


class Sgp4Orbit:
    """A satellite orbit propagated by SGP4. Time zero is ``epoch_jyear`` (Terrestrial Time)."""

    grounded = False

    def __init__(self, text: str, epoch_jyear: float | None = None) -> None:
        self._satellite: Satrec = read_tle(text)
        known_jyear = tle_epoch_jyear(self._satellite)
        self.epoch_jyear = known_jyear if epoch_jyear is None else epoch_jyear
        away_days = abs(self.epoch_jyear - known_jyear) * DAYS_PER_YEAR
        if away_days > TLE_VALID_DAYS:
            raise BadInput(
                "the simulated date is outside the TLE's validity",
                expected=f"at most {TLE_VALID_DAYS:g} days from Julian year {known_jyear:.3f}",
                got=f"{away_days:.0f} days",
                hint="omit the epoch to use that of the TLE",
            )
        # SGP4's axes rotate by 0.1″ per day, so one constant rotation is sufficient for an exercise.
        self._icrs_from_teme = teme_from_icrs(self.epoch_jyear).T
        self.state(0.0)

    def state(self, time_s: float) -> tuple[Array, Array]:
        days = (self.epoch_jyear - 2000.0) * DAYS_PER_YEAR + (time_s - TT_MINUS_UTC_S) / DAY_S
        whole_days = np.floor(days)
        error, place_km, velocity_km_s = self._satellite.sgp4(J2000_JD + float(whole_days), float(days - whole_days))
        if error:
            raise BadInput(
                f"no orbit at {time_s:.0f} s of simulated time",
                expected="a satellite in orbit",
                got=SGP4_WORDS.get(error, f"SGP4 error {error}"),
            )
        return self._icrs_from_teme @ np.array(place_km), self._icrs_from_teme @ np.array(velocity_km_s)


def tle_epoch_jyear(satellite: Satrec) -> float:
    """Return the Julian year (Terrestrial Time) of an element set."""
    days = float(satellite.jdsatepoch) - J2000_JD + float(satellite.jdsatepochF) + TT_MINUS_UTC_S / DAY_S
    return 2000.0 + days / DAYS_PER_YEAR


@dataclass(frozen=True)
class GroundSite:
    """A site on a spherical Earth: (3,) zenith at time zero, rotating about the Earth's (3,) pole."""

    zenith_icrs: Array
    pole_icrs: Array
    grounded: bool = True

    def state(self, time_s: float) -> tuple[Array, Array]:
        place_km = rotation_from_vector(self.pole_icrs * EARTH_TURN_RAD_S * time_s) @ self.zenith_icrs * EARTH_RADIUS_KM
        return place_km, np.cross(self.pole_icrs * EARTH_TURN_RAD_S, place_km)


@dataclass(frozen=True)
class Inertial:
    """Fixed pointing, or rotation about a fixed camera axis; ``rate_rad_s``: (3,) in camera axes."""

    start: Array
    rate_rad_s: Array
    since_s: float = 0.0

    @classmethod
    def pointing(
        cls, ra_rad: float, dec_rad: float, roll_rad: float, rate_rad_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ) -> Inertial:
        """Return a motion that starts at a boresight and roll."""
        return cls(cam_from_icrs(ra_rad, dec_rad, roll_rad), np.array(rate_rad_s, float))

    def at(self, time_s: float) -> Pose:
        turned = rotation_from_vector(-self.rate_rad_s * (time_s - self.since_s))
        return Pose(turned @ self.start, self.rate_rad_s)


@dataclass(frozen=True)
class Zenith:
    """Earth-pointing satellite on a circular orbit without nodal precession, with the camera pointing to the zenith.

    With the default node the camera points to Orion at the start, where bright stars make matching easy.
    """

    altitude_km: float = 600.0
    inclination_rad: float = float(np.radians(97.8))
    raan_rad: float = float(np.radians(84.0))
    start_rad: float = 0.0

    @property
    def orbit(self) -> CircularOrbit:
        """The satellite's orbit."""
        return CircularOrbit(self.altitude_km, self.inclination_rad, self.raan_rad, self.start_rad)

    @property
    def mean_motion_rad_s(self) -> float:
        """Mean motion in rad/s, from Kepler's third law."""
        return self.orbit.mean_motion_rad_s

    def at(self, time_s: float) -> Pose:
        latitude_rad = self.start_rad + self.mean_motion_rad_s * time_s
        orbit = orbit_from_icrs(self.raan_rad, self.inclination_rad, latitude_rad)
        # The orbit frame rotates about the orbit normal, which is its −y axis.
        rate_orbit = np.array([0.0, -self.mean_motion_rad_s, 0.0])
        return Pose(CAM_FROM_ORBIT @ orbit, CAM_FROM_ORBIT @ rate_orbit)

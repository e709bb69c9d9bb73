"""Prior knowledge of a sensor: the a-priori attitude from an orbit, and the hint for each mode.

Firmware and ground both choose the hint here, so that a replay starts from the same numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss.domain.angles import Array
from gss.domain.rotation import quaternion_from_matrix
from gss.pipeline.chains.modes import Hint, Mode
from gss.pipeline.chains.sunsat_frames import OrbitElements, cam_from_icrs_of

# Earth's gravity, m³/s², and its equatorial radius, m (WGS 84).
EARTH_MU_M3_S2, EARTH_RADIUS_M = 3.986004418e14, 6_378_137.0
REMEMBERED_ATTITUDES = 2
DEFAULT_RADIUS_RAD = float(np.radians(5.0))


@dataclass(frozen=True)
class KnownOrbit:
    """A circular orbit: Ω, i, argument of latitude ω′ at ``epoch_s`` of the device clock, altitude (Jacobs 1995 §1.4)."""

    raan_rad: float
    inclination_rad: float
    latitude_rad: float
    altitude_m: float
    epoch_s: float

    @property
    def rate_rad_s(self) -> float:
        """Mean motion."""
        return float(np.sqrt(EARTH_MU_M3_S2 / (EARTH_RADIUS_M + self.altitude_m) ** 3))

    @property
    def speed_m_s(self) -> float:
        """Orbital speed around the Earth."""
        return self.rate_rad_s * (EARTH_RADIUS_M + self.altitude_m)

    def elements_at(self, at_s: float) -> OrbitElements:
        """Return the elements at a device time."""
        latitude_rad = (self.latitude_rad + self.rate_rad_s * (at_s - self.epoch_s)) % (2 * np.pi)
        return OrbitElements(self.raan_rad, self.inclination_rad, float(latitude_rad))


@dataclass(frozen=True)
class Apriori:
    """Roll, pitch and yaw relative to the orbit frame, from another sensor, and the radius of their maximum error."""

    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    radius_rad: float = DEFAULT_RADIUS_RAD

    @property
    def angles_rad(self) -> tuple[float, float, float]:
        """Roll, pitch, yaw."""
        return self.roll_rad, self.pitch_rad, self.yaw_rad


def apriori_hint(orbit: KnownOrbit, angles_rad: tuple[float, float, float], at_s: float) -> Hint:
    """Return the attitude for roll, pitch and yaw relative to the orbit frame at a device time, for a camera mounted like
    Sunsat's (``BODY_FROM_CAM``, Jacobs 1995 §1.3)."""
    return Hint.from_quaternion(quaternion_from_matrix(cam_from_icrs_of(orbit.elements_at(at_s), *angles_rad)))


@dataclass(frozen=True)
class Known:
    """Prior knowledge for matching a frame. ``quaternion``: last attitude, ``earlier``: consecutive attitudes before it, newest
    first. ``commanded``: from SET_ATTITUDE_HINT, until an attitude is found. ``orbit`` and ``apriori`` are only used
    together."""

    quaternion: Array | None = None
    earlier: tuple[Array, ...] = ()
    commanded: Array | None = None
    commanded_radius_rad: float = DEFAULT_RADIUS_RAD
    orbit: KnownOrbit | None = None
    apriori: Apriori | None = None

    @property
    def has_apriori(self) -> bool:
        """True if an a-priori attitude can be computed."""
        return self.orbit is not None and self.apriori is not None

    def usable(self, wanted: Mode) -> Mode:
        """Return the wanted mode, or the next weaker mode for which the prior knowledge is sufficient."""
        if wanted is Mode.TRACKING and self.quaternion is None:
            wanted = Mode.ASSISTED
        if wanted is Mode.ASSISTED and self.commanded is None and self.quaternion is None and not self.has_apriori:
            return Mode.LOST_IN_SPACE
        return wanted

    def hint(self, mode: Mode, at_s: float) -> Hint | None:
        """Return the hint for a mode: in tracking the last attitude; in assisted mode the commanded hint, else the a-priori
        attitude at that device time, else the last attitude; None when lost in space."""
        if mode is Mode.LOST_IN_SPACE:
            return None
        last = None if self.quaternion is None else Hint.from_quaternion(self.quaternion, self.earlier)
        if mode is Mode.TRACKING and last is not None:
            return last
        if self.commanded is not None:
            return Hint.from_quaternion(self.commanded)
        if self.orbit is not None and self.apriori is not None:
            return apriori_hint(self.orbit, self.apriori.angles_rad, at_s)
        return last

    def radius_rad(self, mode: Mode) -> float:
        """Maximum error of the hint in an assisted iteration."""
        if self.commanded is None and self.apriori is not None and self.orbit is not None and mode is Mode.ASSISTED:
            return self.apriori.radius_rad
        return self.commanded_radius_rad

    def after(self, quaternion: Array | None) -> Known:
        """Return the knowledge after an iteration: a new attitude clears the commanded hint; without one (None), ``earlier`` is
        cleared."""
        if quaternion is None:
            return Known(self.quaternion, (), self.commanded, self.commanded_radius_rad, self.orbit, self.apriori)
        before = () if self.quaternion is None else (self.quaternion, *self.earlier)
        return Known(quaternion, before[:REMEMBERED_ATTITUDES], orbit=self.orbit, apriori=self.apriori)

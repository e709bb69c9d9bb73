"""What a sensor may take for granted before it looks: the a-priori attitude of an orbit, and which hint each mode uses.

Firmware and ground choose the hint here and nowhere else, so that a replay starts from the same numbers.
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
    """A circular orbit: Ω, i, argument of latitude ω′ at ``epoch_s`` of the device's clock, height (Jacobs 1995 §1.4)."""

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
        """Round the Earth."""
        return self.rate_rad_s * (EARTH_RADIUS_M + self.altitude_m)

    def elements_at(self, at_s: float) -> OrbitElements:
        """Elements at a device time."""
        latitude_rad = (self.latitude_rad + self.rate_rad_s * (at_s - self.epoch_s)) % (2 * np.pi)
        return OrbitElements(self.raan_rad, self.inclination_rad, float(latitude_rad))


@dataclass(frozen=True)
class Apriori:
    """Roll, pitch and yaw against the orbit as another sensor gives them, and the radius that surely holds the truth."""

    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    radius_rad: float = DEFAULT_RADIUS_RAD

    @property
    def angles_rad(self) -> tuple[float, float, float]:
        """Roll, pitch, yaw."""
        return self.roll_rad, self.pitch_rad, self.yaw_rad


def apriori_hint(orbit: KnownOrbit, angles_rad: tuple[float, float, float], at_s: float) -> Hint:
    """The attitude that roll, pitch and yaw against that orbit mean at a device time, for a camera that is mounted as
    Sunsat's (``BODY_FROM_CAM``, Jacobs 1995 §1.3)."""
    return Hint.from_quaternion(quaternion_from_matrix(cam_from_icrs_of(orbit.elements_at(at_s), *angles_rad)))


@dataclass(frozen=True)
class Known:
    """What is known when a frame is to be matched. ``quaternion``: of the last attitude, ``earlier``: of those in a row
    before it, newest first. ``commanded``: SET_ATTITUDE_HINT until an attitude is found. ``orbit`` and ``apriori`` count
    together only."""

    quaternion: Array | None = None
    earlier: tuple[Array, ...] = ()
    commanded: Array | None = None
    commanded_radius_rad: float = DEFAULT_RADIUS_RAD
    orbit: KnownOrbit | None = None
    apriori: Apriori | None = None

    @property
    def has_apriori(self) -> bool:
        """Is there an a-priori attitude for any time?"""
        return self.orbit is not None and self.apriori is not None

    def usable(self, wanted: Mode) -> Mode:
        """The wanted mode as far as there is the knowledge for it."""
        if wanted is Mode.TRACKING and self.quaternion is None:
            wanted = Mode.ASSISTED
        if wanted is Mode.ASSISTED and self.commanded is None and self.quaternion is None and not self.has_apriori:
            return Mode.LOST_IN_SPACE
        return wanted

    def hint(self, mode: Mode, at_s: float) -> Hint | None:
        """Tracking goes on from the last attitude; assisted takes the commanded hint, else the a-priori attitude at that device
        time, else the last attitude."""
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
        """How far the hint of an assisted iteration may be from the truth."""
        if self.commanded is None and self.apriori is not None and self.orbit is not None and mode is Mode.ASSISTED:
            return self.apriori.radius_rad
        return self.commanded_radius_rad

    def after(self, quaternion: Array | None) -> Known:
        """Knowledge after an iteration: a found attitude takes the commanded hint away, none breaks the row of earlier ones."""
        if quaternion is None:
            return Known(self.quaternion, (), self.commanded, self.commanded_radius_rad, self.orbit, self.apriori)
        before = () if self.quaternion is None else (self.quaternion, *self.earlier)
        return Known(quaternion, before[:REMEMBERED_ATTITUDES], orbit=self.orbit, apriori=self.apriori)

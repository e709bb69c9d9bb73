"""Prior knowledge of a sensor: a-priori attitude from an orbit, and hint for each mode.

Simulated firmware and ground replay use this module to choose the hint, so that a replay starts from the same values.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np

from gss.domain.angles import Array
from gss.domain.rotation import matrix_from_quaternion, quaternion_from_matrix, rotation_angle_rad
from gss.pipeline.chains.modes import AttitudePrior, Mode
from gss.pipeline.chains.sunsat_frames import OrbitElements, cam_from_icrs_of

# Earth's gravity, m³/s², and its equatorial radius, m (WGS 84).
EARTH_MU_M3_S2, EARTH_RADIUS_M = 3.986004418e14, 6_378_137.0
REMEMBERED_ATTITUDES = 2
DEFAULT_RADIUS_RAD = float(np.radians(5.0))


@dataclass(frozen=True)
class KnownOrbit:
    """Circular orbit (Jacobs 1995 §1.4): Ω, i, altitude, and the argument of latitude ω′ at the device time
    ``epoch_s``."""

    raan_rad: float
    inclination_rad: float
    latitude_rad: float
    altitude_m: float
    epoch_s: float

    @property
    def rate_rad_s(self) -> float:
        """Return the mean motion."""
        return float(np.sqrt(EARTH_MU_M3_S2 / (EARTH_RADIUS_M + self.altitude_m) ** 3))

    @property
    def speed_m_s(self) -> float:
        """Return the orbital speed around the Earth."""
        return self.rate_rad_s * (EARTH_RADIUS_M + self.altitude_m)

    def elements_at(self, at_s: float) -> OrbitElements:
        """Return the elements at a device time."""
        latitude_rad = (self.latitude_rad + self.rate_rad_s * (at_s - self.epoch_s)) % (2 * np.pi)
        return OrbitElements(self.raan_rad, self.inclination_rad, float(latitude_rad))


@dataclass(frozen=True)
class Apriori:
    """Roll, pitch and yaw relative to the orbit frame, from another sensor, and maximum error of the attitude."""

    roll_rad: float
    pitch_rad: float
    yaw_rad: float
    radius_rad: float = DEFAULT_RADIUS_RAD

    @property
    def angles_rad(self) -> tuple[float, float, float]:
        """Return roll, pitch and yaw."""
        return self.roll_rad, self.pitch_rad, self.yaw_rad


def apriori_hint(orbit: KnownOrbit, angles_rad: tuple[float, float, float], at_s: float) -> AttitudePrior:
    """Return the attitude for roll, pitch and yaw relative to the orbit frame at a device time, for a camera mounted like
    Sunsat's (``BODY_FROM_CAM``, Jacobs 1995 §1.3)."""
    return AttitudePrior.from_quaternion(quaternion_from_matrix(cam_from_icrs_of(orbit.elements_at(at_s), *angles_rad)))


@dataclass(frozen=True)
class TimedAttitude:
    """Attitude of a frame at a device time: (4,) quaternion cam_from_icrs."""

    quaternion: Array
    time_s: float


@dataclass(frozen=True)
class PriorState:
    """Prior knowledge for matching a frame. ``series``: the last consecutive attitudes, newest first; ``failed``: True
    if an iteration without an attitude followed, so that the next attitude starts a new series. ``commanded``: hint of
    SET_ATTITUDE_HINT, valid until an attitude is computed. ``orbit`` and ``apriori`` are used only together."""

    series: tuple[TimedAttitude, ...] = ()
    failed: bool = False
    commanded: Array | None = None
    commanded_radius_rad: float = DEFAULT_RADIUS_RAD
    orbit: KnownOrbit | None = None
    apriori: Apriori | None = None

    @property
    def quaternion(self) -> Array | None:
        """Return the quaternion of the last attitude, or None."""
        return self.series[0].quaternion if self.series else None

    @property
    def earlier(self) -> tuple[Array, ...]:
        """Return the quaternions of the attitudes before the last."""
        return tuple(entry.quaternion for entry in self.series[1:])

    @property
    def rate_rad_s(self) -> float:
        """Return the angular rate between the last two consecutive attitudes; NaN if an attitude or its time is missing."""
        if len(self.series) < 2:
            return math.nan
        last, before = self.series[0], self.series[1]
        now, then = matrix_from_quaternion(last.quaternion), matrix_from_quaternion(before.quaternion)
        return rotation_angle_rad(now, then) / (last.time_s - before.time_s)

    @property
    def has_apriori(self) -> bool:
        """True if an a-priori attitude can be computed."""
        return self.orbit is not None and self.apriori is not None

    def usable(self, requested: Mode, at_s: float = math.nan, oldest_s: float = math.inf) -> Mode:
        """Return the requested mode, or the next weaker mode for which the prior knowledge is sufficient. Tracking a
        frame at ``at_s`` needs an attitude that is at most ``oldest_s`` old."""
        if requested is Mode.TRACKING and (not self.series or at_s - self.series[0].time_s > oldest_s):
            requested = Mode.ASSISTED
        if requested is Mode.ASSISTED and self.commanded is None and self.quaternion is None and not self.has_apriori:
            return Mode.LOST_IN_SPACE
        return requested

    def hint(self, mode: Mode, at_s: float) -> AttitudePrior | None:
        """Return the hint for a mode: in tracking, the last attitude; in assisted mode, the commanded hint, else the
        a-priori attitude at the device time ``at_s``, else the last attitude; in lost in space, None."""
        if mode is Mode.LOST_IN_SPACE:
            return None
        last = self._last(at_s)
        if mode is Mode.TRACKING and last is not None:
            return last
        if self.commanded is not None:
            return AttitudePrior.from_quaternion(self.commanded)
        if self.orbit is not None and self.apriori is not None and math.isfinite(at_s):
            return apriori_hint(self.orbit, self.apriori.angles_rad, at_s)
        return last

    def _last(self, at_s: float) -> AttitudePrior | None:
        if not self.series:
            return None
        ages_s = tuple(at_s - entry.time_s for entry in self.series)
        # Equal time steps are assumed if frame times are missing or the device's clock was set in between.
        if not all(b > a for a, b in pairwise((0.0, *ages_s))):
            ages_s = ()
        return AttitudePrior.from_quaternion(self.series[0].quaternion, self.earlier, ages_s)

    def radius_rad(self, mode: Mode) -> float:
        """Return the maximum error of the hint in an assisted iteration."""
        if self.commanded is None and self.apriori is not None and self.orbit is not None and mode is Mode.ASSISTED:
            return self.apriori.radius_rad
        return self.commanded_radius_rad

    def after(self, quaternion: Array | None, time_s: float) -> PriorState:
        """Return the prior knowledge after the iteration of a frame at ``time_s`` (NaN if unknown). A new attitude
        clears the commanded hint. Without an attitude (None), only the last attitude is kept, and the next attitude
        starts a new series."""
        if quaternion is None:
            return replace(self, series=self.series[:1], failed=True)
        before = () if self.failed else tuple(entry for entry in self.series if not entry.time_s >= time_s)
        series = (TimedAttitude(quaternion, time_s), *before)[: 1 + REMEMBERED_ATTITUDES]
        return PriorState(series, orbit=self.orbit, apriori=self.apriori)

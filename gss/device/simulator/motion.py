"""Attitude motions: Earth-pointing with an offset, slew to a target, tumble, fixed to the ground."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss.catalogue_tools.envelope.attitude import euler_123
from gss.device.simulator.orbit import CAM_FROM_ORBIT, EARTH_TURN_RAD_S, Orbit, Pose
from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.domain.rotation import quaternion_from_matrix, rotation_from_vector

# Symmetry axis and initial angular momentum of the tumbling body, in camera axes; both are oblique to the boresight.
TUMBLE_SPIN_AXIS = np.array([0.48, 0.6, 0.64])
TUMBLE_MOMENTUM = np.array([0.64, 0.48, 0.6])
TUMBLE_SPIN_SHARE = 0.4


@dataclass(frozen=True)
class EarthPointing:
    """Body axes aligned with the orbit axes (Jacobs 1995 §1.4), offset by constant roll, pitch and yaw (eq. 1.13).

    ``cam_from_body``: (3, 3) mounting.
    """

    orbit: Orbit
    cam_from_body: Array | None = None
    roll_pitch_yaw_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def at(self, time_s: float) -> Pose:
        place_km, velocity_km_s = self.orbit.state(time_s)
        momentum = np.cross(place_km, velocity_km_s)
        nadir, along_y = -place_km / np.linalg.norm(place_km), -momentum / np.linalg.norm(momentum)
        orbit_from_icrs = np.stack([np.cross(along_y, nadir), along_y, nadir])
        mounting = CAM_FROM_ORBIT if self.cam_from_body is None else self.cam_from_body
        cam_from_orbit = mounting @ euler_123(np.array(self.roll_pitch_yaw_rad))
        rate_rad_s = float(np.linalg.norm(momentum) / (place_km @ place_km))
        return Pose(cam_from_orbit @ orbit_from_icrs, cam_from_orbit @ np.array([0.0, -rate_rad_s, 0.0]))


@dataclass(frozen=True)
class Tumble:
    """Torque-free motion of a body of revolution.

    The body spins about its (3,) axis of symmetry, given in camera axes. This axis precesses around the (3,) angular
    momentum, given in ICRS. The angular speed is constant, but the axis of rotation changes.
    """

    start: Array
    spin_axis_cam: Array
    spin_rad_s: float
    momentum_icrs: Array
    precession_rad_s: float
    since_s: float = 0.0

    @classmethod
    def of_rate(cls, start: Array, rate_rad_s: float, since_s: float = 0.0) -> Tumble:
        """Return a tumble with an angular speed, starting from a (3, 3) attitude."""
        spin = TUMBLE_SPIN_SHARE * TUMBLE_SPIN_AXIS
        scale = rate_rad_s / float(np.linalg.norm(spin + TUMBLE_MOMENTUM))
        return cls(start, TUMBLE_SPIN_AXIS, TUMBLE_SPIN_SHARE * scale, start.T @ TUMBLE_MOMENTUM, scale, since_s)

    def at(self, time_s: float) -> Pose:
        t = time_s - self.since_s
        spun = rotation_from_vector(-self.spin_axis_cam * self.spin_rad_s * t)
        gone_round = rotation_from_vector(-self.momentum_icrs * self.precession_rad_s * t)
        attitude = spun @ self.start @ gone_round
        return Pose(
            attitude, self.spin_rad_s * self.spin_axis_cam + self.precession_rad_s * attitude @ self.momentum_icrs
        )


@dataclass(frozen=True)
class SlewTo:
    """Shortest rotation from one (3, 3) attitude to another. The rate is zero at both ends and changes smoothly in
    between."""

    start: Array
    target: Array
    since_s: float
    duration_s: float

    def __post_init__(self) -> None:
        if not self.duration_s > 0:
            raise BadInput(
                "the duration of a slew is out of range", expected="more than 0 s", got=f"{self.duration_s:g} s"
            )

    def at(self, time_s: float) -> Pose:
        part = float(np.clip((time_s - self.since_s) / self.duration_s, 0.0, 1.0))
        done = part - np.sin(2 * np.pi * part) / (2 * np.pi)
        rate = (1 - np.cos(2 * np.pi * part)) / self.duration_s
        x, y, z, w = quaternion_from_matrix(self.target @ self.start.T)
        axis, sine = np.array([x, y, z]), float(np.hypot(np.hypot(x, y), z))
        turn_rad = axis * (2 * np.arctan2(sine, w) / sine) if sine > 0 else axis
        return Pose(rotation_from_vector(turn_rad * done) @ self.start, -turn_rad * rate)


@dataclass(frozen=True)
class EarthFixed:
    """A camera on the ground: (3, 3) attitude at ``since_s``, rotating about the Earth's (3,) pole at sidereal rate."""

    start: Array
    pole_icrs: Array
    since_s: float = 0.0

    def at(self, time_s: float) -> Pose:
        attitude = self.start @ rotation_from_vector(-self.pole_icrs * EARTH_TURN_RAD_S * (time_s - self.since_s))
        return Pose(attitude, EARTH_TURN_RAD_S * attitude @ self.pole_icrs)

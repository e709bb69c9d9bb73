"""Sunsat's coordinate frames (Jacobs 1995 ch. 1) and exact conversions to the project's frames and back.

uv                millimetres on the detector from the optical axis, u = horoptcen − hor, v = vert − vertoptcen (eq. 1.3).
ss                star sensor, +y boresight (eq. 1.4–1.9).   body, orbit, celestial: §1.3–1.5.
The camera model of :mod:`gss.domain.camera` replaces the conversion by u and v; a test checks this conversion as printed.

Handedness: eqs. 1.3 and 1.6 together give x_ss increasing with the columns and z_ss decreasing with v. A drawing with v
upwards *is* a mirror image. This is correct, because the document shows the front of the detector, on which the lens
inverts left and right as well as up and down. The bottom row of that drawing is read out first (§2.2.1.2), and a
television shows the first row at the top. Rows are counted here in read-out order: v = +y of the camera, u = −x, and
``SS_FROM_CAM`` is a rotation, not a reflection. Tests check both.
(The camera profile interprets the calibration of
app. F with v = −y. With v = +y, its optical centre would be as far below the middle as it is now above it, and its tilt
direction 234° instead of 126°. Both cameras are possible, and neither is mirrored here.)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.domain.rotation import rotation_x, rotation_y, rotation_z

# Camera (+z boresight, +x columns, +y rows) to star sensor (+y boresight, x along the columns, z opposite to v).
SS_FROM_CAM = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
# According to the text of §1.3: 180° about x, then −45° about z. Eq. 1.14 has only the second rotation (errata).
BODY_FROM_SS = rotation_z(-np.pi / 4) @ rotation_x(np.pi)
BODY_FROM_CAM = BODY_FROM_SS @ SS_FROM_CAM


def euler_123(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Array:
    """Return the (3, 3) body_from_orbit, the product Aψ·Aθ·Aφ of eqs. 1.10–1.12. Eq. 1.13 has misprints (errata)."""
    return np.asarray(rotation_z(yaw_rad) @ rotation_y(pitch_rad) @ rotation_x(roll_rad))


def roll_pitch_yaw_rad(body_from_orbit: Array) -> tuple[float, float, float]:
    """Return roll, pitch [−π/2, π/2] and yaw of a rotation (eq. 4.17–4.19).

    The document's arcsines limit roll to ±90° and lose precision near it; two-argument arctangents give the same
    values in that range and the right quadrant everywhere. At a pitch of exactly ±90° yaw is set to zero.
    """
    m = np.asarray(body_from_orbit, float)
    in_plane = np.hypot(m[2, 1], m[2, 2])
    pitch = np.arctan2(m[2, 0], in_plane)
    if in_plane < 1e-12:
        return float(np.arctan2(m[0, 1], m[1, 1])) * float(np.sign(m[2, 0])), float(pitch), 0.0
    return float(np.arctan2(-m[2, 1], m[2, 2])), float(pitch), float(np.arctan2(-m[1, 0], m[0, 0]))


def orbit_from_celestial(raan_rad: float, inclination_rad: float, latitude_rad: float) -> Array:
    """Return the (3, 3) A_c→o of eq. 1.18: 90° + Ω about z, −i about y′, −90° about x″, −ω′ about y‴.

    The text has +ω′ about y‴. This axis is opposite to the orbit normal (§1.4), about which the satellite moves with
    increasing ω′. With +ω′, the satellite would move backwards from the node.
    """
    first = rotation_y(-inclination_rad) @ rotation_z(np.pi / 2 + raan_rad)
    return np.asarray(rotation_y(-latitude_rad) @ rotation_x(-np.pi / 2) @ first)


@dataclass(frozen=True)
class OrbitElements:
    """Ω, i and ω′ = argument of perigee + true anomaly (§1.4), in the catalogue's axes."""

    raan_rad: float
    inclination_rad: float
    latitude_rad: float

    def __post_init__(self) -> None:
        if not np.isfinite([self.raan_rad, self.inclination_rad, self.latitude_rad]).all():
            raise BadInput("orbit elements are not numbers", expected="three finite angles", got=repr(self))

    @property
    def orbit_from_icrs(self) -> Array:
        """Return the (3, 3) rotation from ICRS to orbit axes."""
        return orbit_from_celestial(self.raan_rad, self.inclination_rad, self.latitude_rad)


def cam_from_icrs_of(orbit: OrbitElements, roll_rad: float, pitch_rad: float, yaw_rad: float) -> Array:
    """Return the (3, 3) camera attitude from orbit and attitude angles: the transpose of eq. 1.23, combined with the mounting."""
    return np.asarray(BODY_FROM_CAM.T @ euler_123(roll_rad, pitch_rad, yaw_rad) @ orbit.orbit_from_icrs)


def attitude_angles_rad(cam_from_icrs: Array, orbit: OrbitElements) -> tuple[float, float, float]:
    """Return roll, pitch and yaw of a camera attitude relative to an orbit; inverse of :func:`cam_from_icrs_of`."""
    return roll_pitch_yaw_rad(BODY_FROM_CAM @ np.asarray(cam_from_icrs) @ orbit.orbit_from_icrs.T)

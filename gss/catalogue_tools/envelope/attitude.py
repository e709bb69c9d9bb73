"""Camera attitude: a pointing law, the mounting of the camera in the body, and the limits of roll, pitch and yaw."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gss.catalogue_tools.corrections.corrections import ICRS_FROM_ECLIPTIC
from gss.catalogue_tools.envelope.orbits import Range, ordered
from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.domain.frames import cam_from_icrs
from gss.domain.rotation import rotation_x, rotation_z

ORBIT_LAWS = ("sunsat", "zenith", "nadir", "target")
SUN_LAWS = ("anti_sun", "sun_pointing")
FREE_LAWS = ("inertial", *SUN_LAWS)
# Sunsat's star sensor axes (boresight +y, Jacobs 1995 §1.2) relative to the camera axes (boresight +z).
SS_FROM_CAM = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
# The text of Jacobs 1995 §1.3 states 180° about x, then −45° about z. Eq. 1.14 contains only the second rotation
# (errata).
SUNSAT_BODY_FROM_SS = rotation_z(-np.pi / 4) @ rotation_x(np.pi)
BODY_FROM_CAM: dict[str, Array] = {
    "sunsat": SUNSAT_BODY_FROM_SS @ SS_FROM_CAM,
    "zenith": rotation_x(np.pi),
    "nadir": np.eye(3),
    "target": rotation_x(np.pi),
    "inertial": np.eye(3),
    "anti_sun": np.eye(3),
    # Boresight along body +x, at a right angle to the direction of the Sun.
    "sun_pointing": np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]),
}


@dataclass(frozen=True)
class AttitudeLimits:
    """Limits of an Euler 1-2-3 rotation about the axes of the pointing law (Jacobs 1995 eq. 1.13).

    ``pointing``: the law. The laws sunsat, zenith and nadir rotate with the orbit. Their base axes are those of the
    orbit, +z to nadir. The camera points along Sunsat's mounting, to zenith or to nadir. target: an imager along body
    +z tracks a point on the ground up to ``off_nadir_rad`` from nadir in any direction, and body +x stays near the
    velocity. Roll and pitch rotate the body to the target, so their limits are widened by ``off_nadir_rad``. The camera
    points along body −z. inertial: the base axes are those of a camera at ``ra_rad``, ``dec_rad``, ``field_roll_rad``;
    this law is also used to track a point in the sky. anti_sun: base +z away from the Sun, +x to ecliptic north.
    sun_pointing: base +z to the Sun, +x to ecliptic north, the camera along body +x. ``body_from_cam``: mounting as
    nine numbers by rows; None: the default mounting of the law.
    """

    pointing: str
    roll_rad: Range = (0.0, 0.0)
    pitch_rad: Range = (0.0, 0.0)
    yaw_rad: Range = (0.0, 0.0)
    ra_rad: float = 0.0
    dec_rad: float = 0.0
    field_roll_rad: float = 0.0
    body_from_cam: tuple[float, ...] | None = None
    off_nadir_rad: float = 0.0

    def __post_init__(self) -> None:
        if self.pointing not in ORBIT_LAWS + FREE_LAWS:
            raise BadInput("unknown pointing law", expected=" | ".join(ORBIT_LAWS + FREE_LAWS), got=self.pointing)
        for name in ("roll", "pitch", "yaw"):
            low, high = ordered(name, getattr(self, f"{name}_rad"))
            if high - low > 2 * np.pi + 1e-9:
                raise BadInput(
                    f"{name} limits are more than 360° apart",
                    expected="at most 360°",
                    got=f"{np.degrees(high - low):g}°",
                )
        if not 0 <= self.off_nadir_rad < np.pi / 2 or (self.off_nadir_rad and self.pointing != "target"):
            raise BadInput(
                "the off-nadir angle is out of range, or the law does not use it",
                expected="0° to 90°, with pointing target",
                got=f"{np.degrees(self.off_nadir_rad):g}° with {self.pointing}",
            )
        if self.body_from_cam is not None:
            m = np.asarray(self.body_from_cam, float)
            if m.shape != (9,) or not np.allclose(m.reshape(3, 3) @ m.reshape(3, 3).T, np.eye(3), atol=1e-6):
                raise BadInput(
                    "the mounting is not a rotation", expected="nine numbers, rows of unit length at right angles"
                )
            if np.linalg.det(m.reshape(3, 3)) < 0:
                raise BadInput(
                    "the mounting matrix is a reflection, not a rotation",
                    expected="determinant 1",
                    got="determinant −1",
                    hint="one axis has the wrong sign",
                )

    @property
    def low(self) -> Array:
        """(3,) smallest roll, pitch, yaw."""
        off = self.off_nadir_rad
        return np.array([self.roll_rad[0] - off, self.pitch_rad[0] - off, self.yaw_rad[0]])

    @property
    def high(self) -> Array:
        """(3,) largest roll, pitch, yaw."""
        off = self.off_nadir_rad
        return np.array([self.roll_rad[1] + off, self.pitch_rad[1] + off, self.yaw_rad[1]])

    @property
    def cam_from_body(self) -> Array:
        """(3, 3) rotation of the mounting."""
        if self.body_from_cam is not None:
            return np.asarray(self.body_from_cam, float).reshape(3, 3).T
        return BODY_FROM_CAM[self.pointing].T


def euler_123(angles_rad: Array) -> Array:
    """Return the (…, 3, 3) coordinate changes for (…, 3) roll, pitch, yaw: Aψ·Aθ·Aφ of Jacobs 1995 eqs. 1.10–1.12 (the
    product printed as eq. 1.13 has misprints)."""
    a = np.asarray(angles_rad, float)
    (cf, ct, cp), (sf, st, sp) = np.moveaxis(np.cos(a), -1, 0), np.moveaxis(np.sin(a), -1, 0)
    rows = [
        [cp * ct, cp * st * sf + sp * cf, -cp * st * cf + sp * sf],
        [-sp * ct, -sp * st * sf + cp * cf, sp * st * cf + cp * sf],
        [st, -ct * sf, ct * cf],
    ]
    return np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)


def mounting_of(body_from_cam: Sequence[float] | None, turns_deg: Sequence[float] | None) -> tuple[float, ...] | None:
    """Return the mounting as nine numbers by rows; None if neither argument is given (the pointing law's default applies).

    ``turns_deg``, instead of ``body_from_cam``: rotations about x, then y, then z that take the body's axes to the
    camera's (the order of Jacobs 1995 eq. 1.13).
    """
    if turns_deg is None:
        return None if body_from_cam is None else tuple(float(x) for x in body_from_cam)
    if body_from_cam is not None:
        raise BadInput(
            "two mountings were given", expected="either a matrix of nine numbers or three rotations", got="both"
        )
    if not np.isfinite(turns_deg).all():
        raise BadInput("a rotation of the mounting is not a number", expected="three angles", got=str(list(turns_deg)))
    return tuple(float(x) for x in euler_123(np.radians(turns_deg)).T.ravel())


def turns_of(body_from_cam: Array) -> tuple[float, float, float]:
    """Return the rotations about x, y and z, in degrees, of a (3, 3) mounting: the inverse of :func:`mounting_of`. If
    the rotation about y is ±90°, only the sum or difference of the other rotations is defined, and x is 0."""
    m = np.asarray(body_from_cam, float).T
    y = float(np.arcsin(np.clip(m[2, 0], -1.0, 1.0)))
    if abs(m[2, 0]) > 1 - 1e-12:
        x, z = 0.0, float(np.arctan2(m[0, 1], m[1, 1]))
    else:
        x, z = float(np.arctan2(-m[2, 1], m[2, 2])), float(np.arctan2(-m[1, 0], m[0, 0]))
    return float(np.degrees(x)), float(np.degrees(y)), float(np.degrees(z))


def orbit_axes(raan_rad: Array, inclination_rad: Array, latitude_rad: Array) -> Array:
    """Return (n, 3, 3) rotations: ``orbit_from_icrs`` of ``gss.domain.frames``, vectorised."""
    co, so, ci, si = np.cos(raan_rad), np.sin(raan_rad), np.cos(inclination_rad), np.sin(inclination_rad)
    cu, su = np.cos(latitude_rad), np.sin(latitude_rad)
    zenith = np.stack([co * cu - so * su * ci, so * cu + co * su * ci, su * si], axis=-1)
    velocity = np.stack([-co * su - so * cu * ci, -so * su + co * cu * ci, cu * si], axis=-1)
    return np.stack([velocity, np.cross(-zenith, velocity), -zenith], axis=-2)


def base_from_icrs(limits: AttitudeLimits, sun_longitude_rad: Array) -> Array:
    """Return the (n, 3, 3) rotations into the base axes of a law that does not rotate with the orbit, for (n,)
    longitudes of the Sun."""
    longitude = np.atleast_1d(np.asarray(sun_longitude_rad, float))
    if limits.pointing == "inertial":
        fixed = cam_from_icrs(limits.ra_rad, limits.dec_rad, limits.field_roll_rad)
        return np.broadcast_to(fixed, (len(longitude), 3, 3))
    c, s, zero = np.cos(longitude), np.sin(longitude), np.zeros_like(longitude)
    rows = [[c, s, zero], [-s, c, zero], [zero, zero, zero + 1]]
    spin = np.stack([np.stack(row, axis=-1) for row in rows], axis=-2)
    return np.asarray(BASE_FROM_SUN[limits.pointing] @ spin @ ICRS_FROM_ECLIPTIC.T)


# Rotations into the base axes of a law, from axes with +x to the Sun and +z to the ecliptic pole.
BASE_FROM_SUN = {
    "anti_sun": np.array([[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]),
    "sun_pointing": np.array([[0.0, 0.0, 1.0], [0.0, -1.0, 0.0], [1.0, 0.0, 0.0]]),
}

"""Sunsat's coordinate frames (Jacobs 1995 ch. 1) and exact conversions to the project's frames and back.

colrow, horvert   pixels and millimetres from the lower left corner of the frame with its dummy and dark columns.
uv                millimetres on the detector from the optical axis, u = horoptcen − hor, v = vert − vertoptcen (eq. 1.3).
ss                star sensor, +y boresight (eq. 1.4–1.9).   body, orbit, celestial: §1.3–1.5.

Handedness: eqs. 1.3 and 1.6 together give x_ss increasing with the columns and z_ss decreasing with v. Drawn with v upwards
that *is* a mirror image, as expected: the document draws the detector from its front, where the lens inverts both left and
right and up and down, so that only one of the two looks right. The bottom row of that drawing is the first to be clocked
out (§2.2.1.2), and a television shows the first row at the top. Rows are counted here in read-out order: v = +y of the
camera, u = −x, and ``SS_FROM_CAM`` is a rotation, not a reflection. Tests check both.
(The camera profile interprets the calibration of app. F with v = −y. With v = +y its optical centre would be as far below the
middle as it is now above, and its tilt 234° instead of 126°. Both are possible cameras, and neither is mirrored here.)
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss.domain.angles import Array, ra_dec_from_unit, unit_from_ra_dec
from gss.domain.camera import Camera
from gss.domain.errors import BadInput
from gss.domain.rotation import rotation_x, rotation_y, rotation_z

# §1.1: dummy and dark columns before the image, dummy and dark rows below it.
DUMMY_COLUMNS, DUMMY_ROWS = 25, 12
# Camera (+z boresight, +x columns, +y rows) to star sensor (+y boresight, x along the columns, z opposite to v).
SS_FROM_CAM = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
# According to the text of §1.3: 180° about x, then −45° about z. Eq. 1.14 has only the second rotation (errata).
BODY_FROM_SS = rotation_z(-np.pi / 4) @ rotation_x(np.pi)
BODY_FROM_CAM = BODY_FROM_SS @ SS_FROM_CAM


@dataclass(frozen=True)
class Plate:
    """The detector in millimetres. ``centre_*_px``: position of the optical axis in the project's pixel coordinates."""

    hunit_mm: float
    vunit_mm: float
    focal_mm: float
    centre_col_px: float
    centre_row_px: float

    @classmethod
    def of(cls, camera: Camera, focal_mm: float) -> Plate:
        """Return the plate of a camera whose lens has that focal length."""
        return cls(
            focal_mm / camera.focal_col_px,
            focal_mm / camera.focal_row_px,
            focal_mm,
            camera.centre_col_px,
            camera.centre_row_px,
        )

    @property
    def optical_centre_mm(self) -> tuple[float, float]:
        """(horoptcen, vertoptcen) of eq. 1.3."""
        h, v = self.horvert_from_pixels(np.array([[self.centre_col_px, self.centre_row_px]]))[0]
        return float(h), float(v)

    def horvert_from_pixels(self, pixels: Array) -> Array:
        """(n, 2) hor, vert in mm of (n, 2) pixels (col, row); in eq. 2.1–2.2 a pixel's centre is at column − 0.5."""
        p = np.asarray(pixels, float) + 0.5 + np.array([DUMMY_COLUMNS, DUMMY_ROWS])
        return np.asarray(p * np.array([self.hunit_mm, self.vunit_mm]))

    def pixels_from_horvert(self, horvert_mm: Array) -> Array:
        """Inverse of :meth:`horvert_from_pixels`."""
        p = np.asarray(horvert_mm, float) / np.array([self.hunit_mm, self.vunit_mm])
        return np.asarray(p - 0.5 - np.array([DUMMY_COLUMNS, DUMMY_ROWS]))

    def uv_from_pixels(self, pixels: Array) -> Array:
        """(n, 2) u, v in mm, as measured (eq. 1.3)."""
        hor, vert = self.horvert_from_pixels(pixels).T
        hor_centre, vert_centre = self.optical_centre_mm
        return np.stack([hor_centre - hor, vert - vert_centre], axis=-1)

    def pixels_from_uv(self, uv_mm: Array) -> Array:
        """Inverse of :meth:`uv_from_pixels`."""
        u, v = np.asarray(uv_mm, float).T
        hor_centre, vert_centre = self.optical_centre_mm
        return self.pixels_from_horvert(np.stack([hor_centre - u, vert_centre + v], axis=-1))


def corrected_uv(uv_mm: Array, camera: Camera, focal_mm: float) -> Array:
    """(n, 2) u, v in mm corrected for tilt and lens aberration (eq. 6.13–6.20) with the camera's distortion, whose axes are −u
    and +v in units of the focal length."""
    flip = np.array([-1.0, 1.0])
    return np.asarray(camera.distortion.undistort(np.asarray(uv_mm, float) * flip / focal_mm) * focal_mm * flip)


def ss_from_uv(uv_mm: Array, focal_mm: float) -> Array:
    """(n, 3) star sensor unit vectors of corrected (n, 2) u, v (``uvtoss``, eq. 1.4–1.6)."""
    u, v = np.moveaxis(np.asarray(uv_mm, float), -1, 0)
    phi = np.arctan2(u, focal_mm)
    lam = np.arctan2(v * np.cos(phi), focal_mm)
    return np.stack([-np.sin(phi) * np.cos(lam), np.cos(phi) * np.cos(lam), -np.sin(lam)], axis=-1)


def uv_from_ss(unit_ss: Array, focal_mm: float) -> Array:
    """(n, 2) u, v in mm of (n, 3) star sensor vectors (``sstouv``, eq. 1.7–1.9 without their arcsine); NaN behind the lens."""
    x, y, z = np.moveaxis(np.asarray(unit_ss, float), -1, 0)
    ahead = np.where(y > 0, y, np.nan)
    return np.stack([-focal_mm * x / ahead, -focal_mm * z / ahead], axis=-1)


def celestial_from_sphere(ra_rad: Array | float, dec_rad: Array | float) -> Array:
    """(…, 3) celestial vectors (``cstoc``, eq. 1.21)."""
    return unit_from_ra_dec(ra_rad, dec_rad)


def sphere_from_celestial(unit: Array) -> tuple[Array, Array]:
    """Right ascension and declination (``ctocs``, eq. 1.22); with arctangents, because its arcsine of z loses half the
    digits at the poles."""
    return ra_dec_from_unit(unit)


def euler_123(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Array:
    """(3, 3) body_from_orbit: Aψ·Aθ·Aφ of eqs. 1.10–1.12, multiplied out; eq. 1.13 has misprints (errata)."""
    return np.asarray(rotation_z(yaw_rad) @ rotation_y(pitch_rad) @ rotation_x(roll_rad))


def roll_pitch_yaw_rad(body_from_orbit: Array) -> tuple[float, float, float]:
    """Roll, pitch [−π/2, π/2] and yaw of a rotation (eq. 4.17–4.19).

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
    """(3, 3) A_c→o of eq. 1.18: 90° + Ω about z, −i about y′, −90° about x″, −ω′ about y‴.

    The text has +ω′ about y‴. That axis is opposite to the orbit normal (§1.4), about which the satellite moves with
    increasing ω′, so that with the plus sign it would move backwards from the node.
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
        """(3, 3) rotation from ICRS to orbit axes."""
        return orbit_from_celestial(self.raan_rad, self.inclination_rad, self.latitude_rad)


def cam_from_icrs_of(orbit: OrbitElements, roll_rad: float, pitch_rad: float, yaw_rad: float) -> Array:
    """(3, 3) camera attitude from orbit and attitude angles: the transpose of eq. 1.23, combined with the mounting."""
    return np.asarray(BODY_FROM_CAM.T @ euler_123(roll_rad, pitch_rad, yaw_rad) @ orbit.orbit_from_icrs)


def attitude_angles_rad(cam_from_icrs: Array, orbit: OrbitElements) -> tuple[float, float, float]:
    """Roll, pitch and yaw of a camera attitude relative to that orbit; inverse of :func:`cam_from_icrs_of`."""
    return roll_pitch_yaw_rad(BODY_FROM_CAM @ np.asarray(cam_from_icrs) @ orbit.orbit_from_icrs.T)

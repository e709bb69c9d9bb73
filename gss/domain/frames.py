"""Named frames and the rotations between them. ``docs/conventions.md`` contains a drawing of them.

icrs   axes of the catalogue.
cam    +z boresight, +x to higher columns, +y to higher rows; right-handed, seen from inside the sphere.
body   axes of the spacecraft; the mounting matrix is ``body_from_cam``.
orbit  Sunsat's axes: z to nadir, x along velocity, y against the orbit normal (Jacobs 1995 §1.4); built by
       :func:`orbit_from_icrs`.
"""

from __future__ import annotations

import numpy as np

from gss.domain.angles import ARCSEC_RAD, Array, unit_from_ra_dec


def cam_from_icrs(ra_rad: float, dec_rad: float, roll_rad: float) -> Array:
    """Return the (3, 3) rotation cam_from_icrs of a camera with its boresight at (ra, dec) and celestial north ``roll_rad``
    counter-clockwise from image up (−y). tetra3 and cedar-solve define roll in the same way."""
    boresight = unit_from_ra_dec(ra_rad, dec_rad)
    east = np.array([-np.sin(ra_rad), np.cos(ra_rad), 0.0])
    north = np.cross(boresight, east)
    c, s = np.cos(roll_rad), np.sin(roll_rad)
    return np.stack([-c * east - s * north, s * east - c * north, boresight])


def ra_dec_roll_rad(cam_from_icrs: Array) -> tuple[float, float, float]:
    """Return the boresight's right ascension [0, 2π), declination, and the roll [0, 2π) of a (3, 3) camera attitude.

    If the boresight is exactly at a pole, right ascension is 0 and roll is measured relative to it.
    """
    m = np.asarray(cam_from_icrs, float)
    bx, by, bz = m[2]
    in_plane = np.hypot(bx, by)
    ra_rad = np.arctan2(by, bx) if in_plane > 1e-12 else 0.0
    east = np.array([-np.sin(ra_rad), np.cos(ra_rad), 0.0])
    north_cam = m @ np.cross(m[2], east)
    roll_rad = np.arctan2(-north_cam[0], -north_cam[1])
    return float(ra_rad % (2 * np.pi)), float(np.arctan2(bz, in_plane)), float(roll_rad % (2 * np.pi))


def pointing_difference_rad(a_from_icrs: Array, b_from_icrs: Array) -> tuple[float, float]:
    """Return the angles of camera ``a`` relative to camera ``b``: across the boresight (never negative) and about the
    boresight (right-handed about +z)."""
    a_from_b = np.asarray(a_from_icrs) @ np.asarray(b_from_icrs).T
    cross_rad = np.arctan2(np.hypot(a_from_b[0, 2], a_from_b[1, 2]), a_from_b[2, 2])
    about_rad = np.arctan2(a_from_b[0, 1] - a_from_b[1, 0], a_from_b[0, 0] + a_from_b[1, 1])
    return float(cross_rad), float(about_rad)


def attitudes_agree(cross_rad: float, about_rad: float) -> bool:
    """True if two attitudes that differ by these angles agree. The limits are several times the error of the least accurate
    chain."""
    return cross_rad < AGREE_CROSS_RAD and abs(about_rad) < AGREE_ABOUT_RAD


AGREE_CROSS_RAD = 120 * ARCSEC_RAD
AGREE_ABOUT_RAD = 360 * ARCSEC_RAD


def orbit_from_icrs(raan_rad: float, inclination_rad: float, argument_of_latitude_rad: float) -> Array:
    """Return the (3, 3) rotation from ICRS to Sunsat's orbit axes: +z to nadir, +x along the velocity of a circular orbit,
    +y = z × x, against the orbit normal (Jacobs 1995 §1.4)."""
    co, so = np.cos(raan_rad), np.sin(raan_rad)
    ci, si = np.cos(inclination_rad), np.sin(inclination_rad)
    cu, su = np.cos(argument_of_latitude_rad), np.sin(argument_of_latitude_rad)
    zenith = np.array([co * cu - so * su * ci, so * cu + co * su * ci, su * si])
    velocity = np.array([-co * su - so * cu * ci, -so * su + co * cu * ci, cu * si])
    return np.stack([velocity, np.cross(-zenith, velocity), -zenith])

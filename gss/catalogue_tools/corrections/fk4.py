"""The FK4 frame of old catalogues, B1950, used by Sunsat (Jacobs 1995 §7.7: "Epoch 1950").

The FK4 rotates slowly relative to ICRS, so the rotation depends on the epoch of the position (Murray 1989, A&A 218,
325, eqs. 28 and 29). FK4 positions can include the E-terms (0.34″), the part of annual aberration that is caused by the
ellipticity of the Earth's orbit. The caller must state whether they are included. Tests compare with astropy.
"""

from __future__ import annotations

import numpy as np

from gss.domain.angles import ARCSEC_RAD, Array
from gss.domain.rotation import rotation_x, rotation_y, rotation_z

# Rotation to FK5 at J2000 from FK4 at B1950 without E-terms, for positions of J1950, and its change per Julian century
# (Murray 1989).
FK5_FROM_FK4 = np.array(
    [
        [0.9999256794956877, -0.0111814832204662, -0.0048590038153592],
        [0.0111814832391717, 0.9999374848933135, -0.0000271625947142],
        [0.0048590037723143, -0.0000271702937440, 0.9999881946023742],
    ]
)
FK5_FROM_FK4_PER_CENTURY = 1e-6 * np.array(
    [
        [-0.0026455262, -1.1539918689, 2.1111346190],
        [1.1540628161, -0.0129042997, 0.0236021478],
        [-2.1112979048, -0.0056024448, 0.0102587734],
    ]
)
# FK5 at J2000 from ICRS (Mignard and Frœschlé 2000, A&A 354, 732), milliarcseconds about x, y and z.
FK5_FROM_ICRS = rotation_x(19.9e-3 * ARCSEC_RAD) @ rotation_y(9.1e-3 * ARCSEC_RAD) @ rotation_z(-22.9e-3 * ARCSEC_RAD)
# Constant of aberration, eccentricity, longitude of perigee and obliquity at B1950 (Explanatory Supplement 1992 §3.53).
E_TERMS_ABERRATION_RAD = 20.49552 * ARCSEC_RAD
E_TERMS_ECCENTRICITY = 0.01673011
E_TERMS_PERIGEE_RAD = 1015489.951 * ARCSEC_RAD
E_TERMS_OBLIQUITY_RAD = 84404.84 * ARCSEC_RAD


def e_terms() -> Array:
    """Return the (3,) E-terms of B1950 as a vector in its axes."""
    size = E_TERMS_ABERRATION_RAD * E_TERMS_ECCENTRICITY
    sin, cos = np.sin(E_TERMS_PERIGEE_RAD), np.cos(E_TERMS_PERIGEE_RAD)
    obliquity = E_TERMS_OBLIQUITY_RAD
    return np.asarray(size * np.array([sin, -cos * np.cos(obliquity), -cos * np.sin(obliquity)]))


def icrs_from_b1950(epoch_jyear: float) -> Array:
    """Return the (3, 3) matrix to ICRS from B1950 without E-terms, for positions of that epoch. It is a rotation to
    within 1e-11."""
    return np.asarray(FK5_FROM_ICRS.T @ (FK5_FROM_FK4 + FK5_FROM_FK4_PER_CENTURY * (epoch_jyear - 1950.0) / 100))


def icrs_from_b1950_per_year() -> Array:
    """Return the (3, 3) change per Julian year of the matrix of :func:`icrs_from_b1950`. The change is not zero,
    because the FK4 frame rotates."""
    return np.asarray(FK5_FROM_ICRS.T @ FK5_FROM_FK4_PER_CENTURY / 100)


def add_e_terms(unit: Array) -> Array:
    """Add the E-terms to (n, 3) positions."""
    return _unit(np.asarray(unit) + e_terms())


def remove_e_terms(unit: Array) -> Array:
    """Remove the E-terms from (n, 3) positions. Exact inverse of ``add_e_terms``."""
    e, u = e_terms(), np.asarray(unit)
    along = u @ e
    length = along + np.sqrt(1 - e @ e + along**2)
    return np.asarray(length[..., None] * u - e)


def to_b1950(unit: Array, motion_rad_yr: Array, epoch_jyear: float, with_e_terms: bool) -> tuple[Array, Array]:
    """Convert (n, 3) ICRS positions and motions at ``epoch_jyear`` to B1950 axes."""
    matrix, rate = icrs_from_b1950(epoch_jyear).T, icrs_from_b1950_per_year().T
    place = _unit(unit @ matrix.T)
    motion = _tangent(motion_rad_yr @ matrix.T + unit @ rate.T, place)
    return (add_e_terms(place), _tangent(motion, add_e_terms(place))) if with_e_terms else (place, motion)


def from_b1950(unit: Array, motion_rad_yr: Array, epoch_jyear: float, with_e_terms: bool) -> tuple[Array, Array]:
    """Convert (n, 3) B1950 positions and motions at ``epoch_jyear`` to ICRS axes."""
    matrix, rate = icrs_from_b1950(epoch_jyear), icrs_from_b1950_per_year()
    place = remove_e_terms(unit) if with_e_terms else np.asarray(unit)
    icrs = _unit(place @ matrix.T)
    return icrs, _tangent(_tangent(motion_rad_yr, place) @ matrix.T + place @ rate.T, icrs)


def _unit(vector: Array) -> Array:
    return np.asarray(vector / np.linalg.norm(vector, axis=-1, keepdims=True))


def _tangent(motion: Array, unit: Array) -> Array:
    return np.asarray(motion - unit * np.sum(unit * motion, axis=-1, keepdims=True))

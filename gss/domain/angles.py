"""Angles on the sphere, in radians."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

ARCSEC_RAD = np.pi / 648_000.0
TWO_PI_RAD = 2.0 * np.pi
COSINE_ERROR = 1e-12
"""Upper limit of the error of a dot product of unit vectors in double precision."""
_AFTER, _BEFORE = [1, 2, 0], [2, 0, 1]


def wrap_pi_rad(angle_rad: Array | float) -> Array | float:
    """Return the angle wrapped to [−π, π)."""
    return np.mod(np.asarray(angle_rad) + np.pi, TWO_PI_RAD) - np.pi


def unit_from_ra_dec(ra_rad: Array | float, dec_rad: Array | float) -> Array:
    """Return (…, 3) unit vectors from right ascension and declination."""
    ra, dec = np.broadcast_arrays(np.asarray(ra_rad, float), np.asarray(dec_rad, float))
    return np.stack([np.cos(dec) * np.cos(ra), np.cos(dec) * np.sin(ra), np.sin(dec)], axis=-1)


def ra_dec_from_unit(unit: Array) -> tuple[Array, Array]:
    """Return right ascension [0, 2π) and declination of (…, 3) vectors of any non-zero length.

    atan2 has full precision at the poles, where the arcsine of z loses half of the digits.
    """
    x, y, z = np.moveaxis(np.asarray(unit, float), -1, 0)
    return np.mod(np.arctan2(y, x), TWO_PI_RAD), np.arctan2(z, np.hypot(x, y))


def lengths(vectors: Array) -> Array:
    """Return the (…) lengths of (…, 3) vectors. Faster than numpy's norm for so short an axis."""
    return np.asarray(np.sqrt(np.einsum("...k,...k->...", vectors, vectors)))


def cross(a: Array, b: Array) -> Array:
    """Return the (…, 3) vector products. Faster than numpy's for so short an axis."""
    return np.asarray(a[..., _AFTER] * b[..., _BEFORE] - a[..., _BEFORE] * b[..., _AFTER])


def separation_rad(a: Array, b: Array) -> Array:
    """Return the angle between (…, 3) unit vectors, computed from the chord.

    Jacobs 1995 eq. C.7 takes the arccosine of the dot product, which loses 1e-8 rad at small angles. The arctangent of
    |a − b| over |a + b| is accurate at all angles.
    """
    return np.asarray(2.0 * np.arctan2(lengths(np.asarray(a) - b), lengths(np.asarray(a) + b)))

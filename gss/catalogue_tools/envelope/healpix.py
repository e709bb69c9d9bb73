"""Equal-area pixels on the sphere in ring order: centres and a search index (Górski et al. 2005).

Tests compare the functions with astropy-healpix. The package is not used here because importing astropy takes a second.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array


@lru_cache(maxsize=8)
def centres(nside: int) -> Array:
    """Return the (12·nside², 3) read-only unit vectors of the pixel centres in ring order."""
    ring = np.arange(1, 4 * nside)
    from_pole = np.minimum(ring, 4 * nside - ring)
    in_cap = from_pole < nside
    in_ring = 4 * np.minimum(from_pole, nside)
    cap_z = 1 - from_pole**2 / (3 * nside**2)
    z_of_ring = np.where(in_cap, np.where(ring < 2 * nside, cap_z, -cap_z), 4 / 3 - 2 * ring / (3 * nside))
    shift = np.where(in_cap, 0.5, 0.5 * ((ring - nside + 1) % 2))
    z = np.repeat(z_of_ring, in_ring)
    number = np.arange(len(z)) - np.repeat(np.cumsum(in_ring) - in_ring, in_ring)
    phi = 2 * np.pi * (number + np.repeat(shift, in_ring)) / np.repeat(in_ring, in_ring)
    flat = np.sqrt(1 - z * z)
    unit = np.stack([flat * np.cos(phi), flat * np.sin(phi), z], axis=-1)
    unit.setflags(write=False)
    return unit


def pixel_area_sr(nside: int) -> float:
    """Solid angle of one pixel."""
    return float(np.pi / (3 * nside**2))


def pixel_of(nside: int, unit: Array) -> NDArray[np.int64]:
    """Return the (n,) ring-order pixel numbers of (n, 3) unit vectors."""
    x, y, z = np.asarray(unit, float).T
    turn = np.mod(np.arctan2(y, x) * (2 / np.pi), 4.0)
    away = np.abs(z)
    low, high = nside * (0.5 + turn), nside * 0.75 * z
    up, down = np.floor(low - high).astype(np.int64), np.floor(low + high).astype(np.int64)
    ring = nside + 1 + up - down
    odd = 1 - (ring & 1)
    column = np.mod((up + down - nside + odd + 1) // 2, 4 * nside)
    belt = 2 * nside * (nside - 1) + (ring - 1) * 4 * nside + column
    part = turn - np.floor(turn)
    scale = nside * np.sqrt(3 * (1 - away))
    right, left = np.floor(part * scale).astype(np.int64), np.floor((1 - part) * scale).astype(np.int64)
    from_pole = right + left + 1
    along = np.mod(np.floor(turn * from_pole).astype(np.int64), 4 * from_pole)
    north = 2 * from_pole * (from_pole - 1) + along
    south = 12 * nside**2 - 2 * from_pole * (from_pole + 1) + along
    return np.asarray(np.where(away <= 2 / 3, belt, np.where(z > 0, north, south)))


def pixel_radius_rad(nside: int) -> float:
    """Upper bound of the distance of a direction from the centre of its pixel."""
    # The largest distance between centre and corner is that of the pixels between cap and belt. A test checks this
    # bound for every nside.
    return float(1.1 * np.sqrt(pixel_area_sr(nside)))

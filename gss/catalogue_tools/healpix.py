"""Equal-area pixels on the sphere, ring order: centres and a search index (Górski et al. 2005). astropy-healpix is the
outside check; these few lines spare the page the second that importing astropy takes."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from gss.domain.angles import Array


@lru_cache(maxsize=8)
def centres(nside: int) -> Array:
    """(12·nside², 3) read-only unit vectors of the pixel centres in ring order."""
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

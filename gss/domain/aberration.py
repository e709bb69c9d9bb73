"""Stellar aberration: the one formula used by catalogues, chains and the simulated sky."""

from __future__ import annotations

import numpy as np

from gss.domain.angles import Array


def aberrate(unit: Array, velocity_c: Array) -> Array:
    """(n, 3) apparent directions of (n, 3) true ones for an observer with (3,) velocity in units of c; exact in v/c."""
    beta = np.asarray(velocity_c, float)
    inverse_gamma = np.sqrt(1 - beta @ beta)
    along = np.asarray(unit) @ beta
    moved = inverse_gamma * np.asarray(unit) + (1 + along / (1 + inverse_gamma))[..., None] * beta
    return np.asarray(moved / (1 + along)[..., None])

"""Stellar aberration. Catalogues, chains and the simulated sky use this formula."""

from __future__ import annotations

import numpy as np

from gss.domain.angles import Array


def aberrate(unit: Array, velocity_c: Array) -> Array:
    """Return (n, 3) apparent directions from (n, 3) true directions, for an observer with (3,) velocity in units of c. The
    formula is exact for all v/c."""
    beta = np.asarray(velocity_c, float)
    inverse_gamma = np.sqrt(1 - beta @ beta)
    along = np.asarray(unit) @ beta
    shifted = inverse_gamma * np.asarray(unit) + (1 + along / (1 + inverse_gamma))[..., None] * beta
    return np.asarray(shifted / (1 + along)[..., None])

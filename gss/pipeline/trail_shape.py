"""Image of a star trailed by the camera's rotation, and its derivatives."""

from __future__ import annotations

import numpy as np
from scipy.special import erf

from gss.domain.angles import Array

LEAST_PX = 0.3  # minimum length during an iteration, because a shorter trail has no direction
UNDIRECTED_PX = 1e-9  # up to this length, the direction is that of the columns


def trailed_gaussian(ax: Array, ay: Array, trail: Array, width2: float) -> tuple[Array, Array]:
    """Return a Gaussian of unit flux and variance ``width2``, moved along ``trail`` (n, 2), at (n, k) offsets. Also
    return its derivatives (n, k, 5) with respect to the two offsets, the two components of the trail, and the
    variance."""
    length = np.hypot(trail[:, 0], trail[:, 1])[:, None]
    direction = np.where(length > UNDIRECTED_PX, trail / np.maximum(length, UNDIRECTED_PX), np.array([1.0, 0.0]))
    ex, ey, long = direction[:, :1], direction[:, 1:], np.maximum(length, LEAST_PX)
    sigma = np.sqrt(width2)
    a, b = ax * ex + ay * ey, ay * ex - ax * ey
    high, low = (a + long / 2) / sigma, (a - long / 2) / sigma
    phi_high, phi_low = (np.exp(-0.5 * t * t) / np.sqrt(2 * np.pi) for t in (high, low))
    between = 0.5 * (erf(high / np.sqrt(2)) - erf(low / np.sqrt(2)))
    across = np.exp(-0.5 * b * b / width2) / (sigma * np.sqrt(2 * np.pi))
    shape = across * between / long
    by_a = across * (phi_high - phi_low) / (sigma * long)
    by_b = -b / width2 * shape
    by_length = across * ((phi_high + phi_low) / (2 * sigma) - between / long) / long
    by_turn = by_a * b - by_b * a
    by_width = shape * (b * b / width2 - 1) / (2 * width2) - across / long * (phi_high * high - phi_low * low) / (
        2 * width2
    )
    slopes = np.stack(
        [
            ex * by_a - ey * by_b,
            ey * by_a + ex * by_b,
            ex * by_length - ey * by_turn / long,
            ey * by_length + ex * by_turn / long,
            by_width,
        ],
        axis=-1,
    )
    return shape, slopes

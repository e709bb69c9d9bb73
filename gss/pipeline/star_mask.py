"""Mask of the pixels that receive light from stars at known positions."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array

NOTICEABLE = 0.3
"""Minimum light of a star in a masked pixel, in units of the pixel noise."""
FAINTEST_PEAK = 0.5
MARGIN_PX = 2.0


def star_mask(
    shape: tuple[int, ...], pixels: Array, flux_dn: Array, trails_px: Array, variance_px2: float, noise_dn: float
) -> NDArray[np.bool_]:
    """Return a (rows, columns) mask, True for pixels to which a star adds a noticeable amount of light.

    ``pixels`` (n, 2): middles of the trails; ``flux_dn`` (n,): light of each star; ``trails_px`` (n, 2): trail vectors,
    zero for a camera at rest; ``variance_px2``: variance of the point-spread function, pixel integration included.
    """
    mask = np.zeros(shape, bool)
    sigma = np.sqrt(variance_px2)
    peak = flux_dn / (2 * np.pi * variance_px2) / noise_dn
    for k in np.flatnonzero(peak > FAINTEST_PEAK):
        trail, middle = trails_px[k], pixels[k]
        radius = sigma * np.sqrt(2 * np.log(max(peak[k], 1.0) / NOTICEABLE)) + MARGIN_PX
        reach = radius + np.abs(trail) / 2
        low = np.maximum(np.floor(middle - reach).astype(int), 0)
        high = np.minimum(np.ceil(middle + reach).astype(int) + 1, (shape[1], shape[0]))
        if (low >= high).any():
            continue
        x, y = np.arange(low[0], high[0]) - middle[0], np.arange(low[1], high[1])[:, None] - middle[1]
        along = np.clip((x * trail[0] + y * trail[1]) / max(float(trail @ trail), 1e-9), -0.5, 0.5)
        near = (x - along * trail[0]) ** 2 + (y - along * trail[1]) ** 2 < radius**2
        mask[low[1] : high[1], low[0] : high[0]] |= near
    return mask

"""Coarse image: sums of pixel blocks, compared with a threshold and used as a noise mask (Moniteq 1983 Fig. 6.1, steps 2d and
3c). The document gives neither the block size nor the threshold."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.pipeline.regions import Pixels

Mask = NDArray[np.bool_]


def dark_mean_dn(pixels: Pixels, noise_dn: float, step_px: int = 1) -> float:
    """Return the mean of the sky pixels, i.e. of those within three standard deviations of the median.

    The median itself is not used, because it is an integer, and its rounding error biases a centroid towards the centre
    of the window (Moniteq 1983 §4.3).
    """
    sample = pixels[::step_px, ::step_px].ravel().astype(float)
    middle = float(np.median(sample))
    dark = sample[np.abs(sample - middle) <= max(3 * noise_dn, 1.0)]
    return float(dark.mean()) if len(dark) else middle


def coarse_image(pixels: Pixels, block_px: int) -> Array:
    """Sum the pixels in blocks; the last blocks are smaller if the frame size is not a multiple of ``block_px``."""
    rows, columns = pixels.shape
    down = np.add.reduceat(pixels.astype(float), np.arange(0, rows, block_px), axis=0)
    return np.asarray(np.add.reduceat(down, np.arange(0, columns, block_px), axis=1))


def coarse_mask(pixels: Pixels, dark_dn: float, noise_dn: float, block_px: int, sigmas: float) -> Mask:
    """Return the (rows, columns) mask of blocks brighter than ``sigmas`` of noise, grown by one pixel to include wings of stars."""
    rows, columns = pixels.shape
    size = coarse_image(np.ones((rows, columns), np.uint8), block_px)
    bright = coarse_image(pixels, block_px) - size * dark_dn > sigmas * noise_dn * np.sqrt(size)
    mask = np.repeat(np.repeat(bright, block_px, axis=0), block_px, axis=1)[:rows, :columns]
    return grown(mask)


def grown(mask: Mask) -> Mask:
    """Return the mask grown by one pixel on all sides, corners included."""
    wide = mask.copy()
    wide[1:] |= mask[:-1]
    wide[:-1] |= mask[1:]
    tall = wide.copy()
    tall[:, 1:] |= wide[:, :-1]
    tall[:, :-1] |= wide[:, 1:]
    return tall


def windows_mask(shape: tuple[int, ...], places_px: Array, half_px: float) -> Mask:
    """Return the (rows, columns) mask of square windows around (n, 2) predicted positions (col, row). NaN positions are skipped."""
    mask = np.zeros(shape, bool)
    for col, row in places_px[np.isfinite(places_px).all(axis=1)].tolist():
        low, high = max(0, int(np.ceil(row - half_px))), int(np.floor(row + half_px)) + 1
        left, right = max(0, int(np.ceil(col - half_px))), int(np.floor(col + half_px)) + 1
        mask[low : max(0, high), left : max(0, right)] = True
    return mask

"""Sub-pixel centroids from a window around the brightest pixel of each star. The border of the window determines the
sky background.

Liebe 1992 calls this method hyperaccuracy. The document states the accuracy (a fifth of a pixel) but not the steps.
Here the sky background is the interquartile mean of the border pixels. All pixels inside the border are used, even
those below the threshold, because the threshold would cause a bias.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.results import Centroids
from gss.pipeline.centroid import PixelNoise
from gss.pipeline.regions import Blobs, Flags, Pixels

# Ratio of the standard error of the interquartile mean of a sample to the standard error of the mean of the whole
# sample.
SKY_NOISE = 1.1
# Additional centroid error of a saturated star, whose peak is flat; measured on rendered frames.
SATURATED_PX = 0.1


def brightest_pixels(pixels: Pixels, blobs: Blobs) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """Return column and row of each blob's brightest pixel, or the rounded mean position of several equally bright
    (saturated) ones."""
    row, col = np.divmod(blobs.index, blobs.columns)
    if not len(blobs):
        return col, row
    value = pixels.ravel()[blobs.index]
    starts, owner = blobs.start[:-1], blobs.owner
    is_peak = value == np.maximum.reduceat(value, starts)[owner]
    count = np.add.reduceat(is_peak.astype(float), starts)
    centre = [
        np.rint(np.add.reduceat(np.where(is_peak, axis, 0.0), starts) / count).astype(np.intp) for axis in (col, row)
    ]
    return centre[0], centre[1]


def inside_frame(col: NDArray[np.intp], row: NDArray[np.intp], shape: tuple[int, ...], half: int) -> Flags:
    """True for each window that lies completely on the detector. ``half``: half width of a window in pixels."""
    return np.asarray((col >= half) & (row >= half) & (col < shape[1] - half) & (row < shape[0] - half))


def hyperaccurate_centroids(
    pixels: Pixels, blobs: Blobs, window_px: int, noise: PixelNoise, saturation_dn: float
) -> Centroids:
    """Compute one centroid per blob, in the blobs' order; each window, ``window_px`` on a side, must lie on the
    detector.

    The outermost ring of the window determines the sky background; the inner pixels determine the centre of gravity and
    the flux.
    """
    n, half = len(blobs), window_px // 2
    if not n:
        return Centroids.from_pixels(np.empty((0, 2)))
    col, row = brightest_pixels(pixels, blobs)
    step = np.arange(-half, half + 1)
    stamp = pixels[row[:, None, None] + step[:, None], col[:, None, None] + step].astype(float)
    ring = np.maximum(np.abs(step)[:, None], np.abs(step)) == half
    border = np.sort(stamp[:, ring], axis=1)
    quarter = border.shape[1] // 4
    # A median of integers can be wrong by 0.5 DN. This would bias the flux of a faint star, which is a sum over 25
    # pixels.
    sky_dn = border[:, quarter:-quarter].mean(axis=1)
    inner = step[1:-1].astype(float)
    light = stamp[:, 1:-1, 1:-1] - sky_dn[:, None, None]
    flux = np.maximum(light.sum(axis=(1, 2)), 1e-9)
    off_col = (light.sum(axis=1) * inner).sum(axis=1) / flux
    off_row = (light.sum(axis=2) * inner).sum(axis=1) / flux
    peak = stamp.max(axis=(1, 2))
    sky_sigma_dn = SKY_NOISE * noise.dark_sigma_dn / np.sqrt(border.shape[1])
    sigma = np.hypot(
        _sigma_px(light, inner, off_col, off_row, flux, noise),
        len(inner) ** 2 * sky_sigma_dn / flux * np.hypot(off_col, off_row) / np.sqrt(2),
    )
    sigma = np.where(peak >= saturation_dn, np.hypot(sigma, SATURATED_PX), sigma)
    return Centroids(col + off_col, row + off_row, flux, peak - sky_dn, blobs.area_px.astype(np.int32), sigma)


def _sigma_px(light: Array, inner: Array, off_col: Array, off_row: Array, flux: Array, noise: PixelNoise) -> Array:
    """Return the (n,) standard deviations per axis of the centres of gravity, from pixel noise."""
    distance2 = (inner[:, None] - off_row[:, None, None]) ** 2 + (inner - off_col[:, None, None]) ** 2
    variance = noise.dark_sigma_dn**2 + np.maximum(light, 0.0) / noise.gain_e_per_dn
    return np.asarray(np.sqrt((distance2 * variance).sum(axis=(1, 2)) / (2 * flux**2) + noise.floor_px**2))

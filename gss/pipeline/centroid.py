"""Centre of gravity in a small window around each star's brightest pixel (Erlank 2013 eq. 4.1.1–2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.results import Centroids
from gss.pipeline.regions import Blobs, Pixels, lit_values


@dataclass(frozen=True)
class PixelNoise:
    """Pixel noise model: dark noise, electrons per digital number, and ``floor_px``, the centroid error that remains without
    noise because pixels have finite size (Erlank 2013 §4.1.6)."""

    dark_sigma_dn: float
    gain_e_per_dn: float
    floor_px: float


# Errors measured on rendered frames with a Gaussian of 1.2 px. CUT_PX: error caused by the threshold for a star whose
# peak equals the threshold. OUTSIDE_PX: error caused by a window that is smaller than the star, multiplied by the share
# of the star's pixels outside the window.
CUT_PX = 0.2
OUTSIDE_PX = 0.4


def window_centroids(
    pixels: Pixels, blobs: Blobs, black_dn: float, threshold_dn: float, window_px: int, noise: PixelNoise
) -> Centroids:
    """Compute one centroid per blob, in the blobs' order. As in §4.1.3, a centroid is computed from the pixels of the
    blob that are in the ``window_px`` square around its brightest pixel, weighted by their intensity above black.

    The document does not say which of several equally bright (saturated) pixels to use; here it is their rounded mean, which
    centres the window on a saturated star. ``threshold_dn``, above black, affects ``sigma_px`` only.
    """
    if not len(blobs):
        return Centroids.from_pixels(np.empty((0, 2)))
    col, row, value = lit_values(pixels, blobs, black_dn)
    owner, n = blobs.owner, len(blobs)
    peak = np.maximum.reduceat(value, blobs.start[:-1])
    brightest = value == peak[owner]
    centre_col = np.rint(_mean(col, brightest.astype(float), owner, n))
    centre_row = np.rint(_mean(row, brightest.astype(float), owner, n))
    half = window_px // 2
    inside = (np.abs(col - centre_col[owner]) <= half) & (np.abs(row - centre_row[owner]) <= half)
    weight = np.where(inside, value, 0.0)
    col_px, row_px = _mean(col, weight, owner, n), _mean(row, weight, owner, n)
    flux = np.bincount(owner, weight, n).astype(float)
    offset2 = (col - col_px[owner]) ** 2 + (row - row_px[owner]) ** 2
    variance = np.where(inside, offset2 * (noise.dark_sigma_dn**2 + value / noise.gain_e_per_dn), 0.0)
    area = blobs.area_px.astype(np.int32)
    model_px = np.hypot(CUT_PX * threshold_dn / peak, OUTSIDE_PX * np.maximum(0.0, 1 - window_px**2 / area))
    sigma2 = np.bincount(owner, variance, n) / (2 * flux**2) + model_px**2 + noise.floor_px**2
    return Centroids(col_px, row_px, flux, peak, area, np.sqrt(sigma2))


def _mean(values: Array, weight: Array, owner: NDArray[np.intp], n: int) -> Array:
    """Return the weighted mean per blob."""
    return np.asarray(np.bincount(owner, weight * values, n) / np.bincount(owner, weight, n))


def brightest_first(centroids: Centroids) -> NDArray[np.intp]:
    """Return the indices that sort by decreasing flux; equal fluxes keep their order."""
    return np.argsort(-centroids.flux_dn, kind="stable")

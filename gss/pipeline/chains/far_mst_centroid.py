"""Star centroids and second moments by weighted sums, or centroids by Winick's maximum likelihood (Huffman 2006 §4.2.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import erf

from gss.domain.angles import Array
from gss.domain.results import Centroids
from gss.pipeline.chains.far_mst_parameters import FarMstParameters
from gss.pipeline.regions import Blobs, Pixels

PIXEL_PX2 = 1 / 12
# Errors measured on rendered frames. CUT_PER_SIGMA: error of the irregular threshold cut, per px of the spot's σ, for a
# star whose peak equals the threshold. BLOCK_PX, at most BLOCK_MOST_PX: error of the straight cuts of the block grid.
# This error decreases only with the square root of the peak.
CUT_PER_SIGMA = 0.42
BLOCK_PX, BLOCK_MOST_PX = 0.85, 0.35
FLOOR_PX = 0.02
MLE_FLOOR_PX = 0.01
STAMP_SIGMAS = 3.0
SCORING_STEPS = 8
MAX_STEP_PX = 0.5
FARTHEST_PX = 2.0


@dataclass(frozen=True)
class Signal:
    """Frame above its dark level, computed only for the requested pixels. ``dark_dn``: scalar array or (rows, columns)."""

    pixels: Pixels
    dark_dn: Array

    def at(self, index: NDArray[np.intp]) -> Array:
        """Return the values at flat pixel indices, in the shape of ``index``."""
        dark = self.dark_dn if self.dark_dn.ndim == 0 else self.dark_dn.ravel()[index]
        return np.asarray(self.pixels.ravel()[index] - dark, float)


@dataclass(frozen=True)
class ClusterMoments:
    """Moments of m clusters, (m,) each: weighted-sum position, flux and peak. ``aspect``: √(λ1/λ2) of the second
    moments, which include the size of a pixel, so the ratio is finite for a line of pixels; ``length_px``: length of a
    streak with the longer moment; ``spread_px2``: Σ (x − x̄)² v, and ``lever_px2``: Σ (x − x̄)², both averaged over the
    axes, for error propagation."""

    col_px: Array
    row_px: Array
    flux_dn: Array
    peak_dn: Array
    area_px: NDArray[np.int32]
    aspect: Array
    length_px: Array
    spread_px2: Array
    lever_px2: Array


def shapes_of(signal: Signal, blobs: Blobs) -> ClusterMoments:
    """Compute the moments. Every pixel of a cluster is weighted with its full value above dark (eq. 4.1)."""
    n, owner = len(blobs), blobs.owner
    row, col = (x.astype(float) for x in np.divmod(blobs.index, blobs.columns))
    value = signal.at(blobs.index)
    if not n:
        none = np.empty(0)
        return ClusterMoments(none, none, none, none, np.empty(0, np.int32), none, none, none, none)
    flux = _sum(value, owner, n)
    col_px, row_px = _sum(value * col, owner, n) / flux, _sum(value * row, owner, n) / flux
    dx, dy = col - col_px[owner], row - row_px[owner]
    xx, yy, xy = (_sum(value * m, owner, n) / flux for m in (dx * dx, dy * dy, dx * dy))
    middle, split = (xx + yy) / 2 + PIXEL_PX2, np.hypot((xx - yy) / 2, xy)
    return ClusterMoments(
        col_px,
        row_px,
        flux,
        np.maximum.reduceat(value, blobs.start[:-1]),
        blobs.area_px.astype(np.int32),
        np.sqrt((middle + split) / np.maximum(middle - split, PIXEL_PX2)),
        np.sqrt(12 * (middle + split)),
        (xx + yy) / 2 * flux,
        _sum(dx * dx + dy * dy, owner, n) / 2,
    )


def _sum(values: Array, owner: NDArray[np.intp], n: int) -> Array:
    return np.bincount(owner, values, n).astype(float)


def weighted_sum(shapes: ClusterMoments, threshold_dn: float, noise_dn: float, p: FarMstParameters) -> Centroids:
    """Return the centroids of the clusters, in their order, with ``sigma_px`` per axis according to ``p.sigma_model``."""
    if p.sigma_model == "document":
        sigma = document_sigma_px(shapes.peak_dn / noise_dn)
    else:
        noise_px2 = (noise_dn**2 * shapes.lever_px2 + shapes.spread_px2 / p.gain_e_per_dn) / shapes.flux_dn**2
        cut_px = p.psf_sigma_px * CUT_PER_SIGMA * threshold_dn / shapes.peak_dn
        if p.prefilter == "block":
            blocked = np.minimum(BLOCK_PX * np.sqrt(threshold_dn / shapes.peak_dn), BLOCK_MOST_PX)
            cut_px = np.maximum(cut_px, blocked)
        sigma = np.sqrt(noise_px2 + cut_px**2 + FLOOR_PX**2)
    return Centroids(shapes.col_px, shapes.row_px, shapes.flux_dn, shapes.peak_dn, shapes.area_px, sigma)


def document_sigma_px(snr: Array) -> Array:
    """Return the standard deviation of a weighted-sum centroid for a peak signal-to-noise ratio (eq. 4.2, where
    "psfWidth" is a misprint)."""
    return np.asarray(0.11 + 0.5 * np.maximum(snr, 1e-3) ** -1.3)


def refine_mle(signal: Signal, noise_dn: float, stars: Centroids, p: FarMstParameters) -> Centroids:
    """Move the centroids of all stars to the maximum of the likelihood (eq. 4.5–4.8, 4.11).

    Q = 0 is solved by Fisher scoring, which also gives the Cramér–Rao bound (eq. 4.3) as ``sigma_px``. λ_s is estimated
    as well. As in Winick's model, λ_N is the mean noise count of a pixel (the document states the standard deviation).
    The square of the read noise R is added to both the counts and the mean, so that the result is a Poisson variable
    with the correct variance. Saturated pixels are not used. If the iteration of a star diverges, its weighted sum is
    used.
    """
    if not len(stars):
        return stars
    count_e, use, dx, dy = _stamps(signal, stars, p)
    background_e = (noise_dn * p.gain_e_per_dn) ** 2
    offset = np.column_stack([stars.col_px - np.rint(stars.col_px), stars.row_px - np.rint(stars.row_px)])
    state = np.column_stack([offset, stars.flux_dn * p.gain_e_per_dn])
    for _ in range(SCORING_STEPS):
        score, information = _score(state, count_e, use, dx, dy, background_e, p.psf_sigma_px)
        step = np.einsum("nij,nj->ni", np.linalg.pinv(information, hermitian=True), score)
        step[:, :2] = np.clip(step[:, :2], -MAX_STEP_PX, MAX_STEP_PX)
        state = state + step
        state[:, 2] = np.maximum(state[:, 2], background_e**0.5)
    _, information = _score(state, count_e, use, dx, dy, background_e, p.psf_sigma_px)
    variance = np.linalg.pinv(information, hermitian=True)
    sigma = np.sqrt((variance[:, 0, 0] + variance[:, 1, 1]) / 2)
    good = (np.abs(state[:, :2] - offset) < FARTHEST_PX).all(axis=1) & np.isfinite(sigma) & (sigma > 0)
    return Centroids(
        np.where(good, np.rint(stars.col_px) + state[:, 0], stars.col_px),
        np.where(good, np.rint(stars.row_px) + state[:, 1], stars.row_px),
        np.where(good, state[:, 2] / p.gain_e_per_dn, stars.flux_dn),
        stars.peak_dn,
        stars.area_px,
        np.where(good, np.hypot(sigma, MLE_FLOOR_PX), stars.sigma_px),
    )


def _stamps(signal: Signal, stars: Centroids, p: FarMstParameters) -> tuple[Array, NDArray[np.bool_], Array, Array]:
    """Return (n, w, w) electrons above dark around each star, a mask of usable ones, and (w,) offsets in columns and rows."""
    rows, columns = signal.pixels.shape
    half = int(np.ceil(STAMP_SIGMAS * p.psf_sigma_px))
    offset = np.arange(-half, half + 1)
    col = np.rint(stars.col_px).astype(np.intp)[:, None, None] + offset[None, None, :]
    row = np.rint(stars.row_px).astype(np.intp)[:, None, None] + offset[None, :, None]
    inside = (col >= 0) & (col < columns) & (row >= 0) & (row < rows)
    index = np.clip(row, 0, rows - 1) * columns + np.clip(col, 0, columns - 1)
    use = inside & (signal.pixels.ravel()[index] < p.saturation_dn)
    return signal.at(index) * p.gain_e_per_dn, use, offset.astype(float), offset.astype(float)


def _score(
    state: Array, count_e: Array, use: NDArray[np.bool_], dx: Array, dy: Array, background_e: float, sigma_px: float
) -> tuple[Array, Array]:
    """Return the (n, 3) gradient of the log likelihood with respect to x, y and λ_s, and the (n, 3, 3) Fisher information."""
    gx, slope_x = _share(dx[None] - state[:, :1], sigma_px)
    gy, slope_y = _share(dy[None] - state[:, 1:2], sigma_px)
    star_e = state[:, 2, None, None]
    mean = star_e * gy[:, :, None] * gx[:, None, :] + background_e
    slopes = np.stack(
        [
            star_e * gy[:, :, None] * slope_x[:, None, :],
            star_e * slope_y[:, :, None] * gx[:, None, :],
            gy[:, :, None] * gx[:, None, :],
        ],
        axis=1,
    )
    weighted = slopes * (use / mean)[:, None]
    residual = count_e + background_e - mean
    score = np.einsum("nkij,nij->nk", weighted, residual)
    return score, np.einsum("nkij,nlij->nkl", weighted, slopes)


def _share(distance_px: Array, sigma_px: float) -> tuple[Array, Array]:
    """Return the share of a one-dimensional Gaussian in a pixel ``distance_px`` away (eq. 4.7), and its derivative with
    respect to the star's position."""
    scale = 1 / (np.sqrt(2) * sigma_px)
    low, high = (distance_px - 0.5) * scale, (distance_px + 0.5) * scale
    density = np.exp(-low * low) - np.exp(-high * high)
    return np.asarray(0.5 * (erf(high) - erf(low))), np.asarray(density * scale / np.sqrt(np.pi))

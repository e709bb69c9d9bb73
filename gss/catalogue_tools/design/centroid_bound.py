"""Lower bound of the centroid error: Cramér–Rao bound of a Gaussian star on noisy pixels (Winick 1986, used by Huffman
2006 §4.2.2). The non-uniform pixel response is treated as additional noise."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.special import ndtr

from gss.catalogue_tools.design.camera import DesignCamera
from gss.catalogue_tools.design.radiometry import (
    PSF_GRID_PX,
    PsfAdvice,
    limit_brightest_pixel_mag,
    limit_mag,
    limit_window_mag,
    psf_kind,
    with_psf,
)
from gss.domain.angles import Array

PHASES = 5
REACH_SIGMAS = 5.0
GRID_E = np.geomspace(1.0, 1e9, 73)


def bound_px(star_e: Array | float, sigma_px: float, noise_e: float, response_sigma: float = 0.0) -> Array:
    """Return the smallest standard deviation of one coordinate, px, for stars of ``star_e`` electrons, an array of any
    shape.

    ``noise_e``: noise of a dark-sky pixel. The information is averaged over the star's position within its pixel. The
    bound also holds if flux and background are unknown, because they do not shift the centroid of a symmetric star.
    """
    table = _table(round(float(sigma_px), 6), round(float(noise_e), 6), round(float(response_sigma), 9))
    log_e = np.log(np.maximum(np.asarray(star_e, float), GRID_E[0]))
    return np.asarray(np.exp(np.interp(log_e, np.log(GRID_E), table)))


@lru_cache(maxsize=512)
def _table(sigma_px: float, noise_e: float, response_sigma: float) -> Array:
    """Return log σ on the grid of electrons."""
    return np.asarray(np.log(exact_bound_px(GRID_E, sigma_px, noise_e, response_sigma)))


def exact_bound_px(star_e: Array, sigma_px: float, noise_e: float, response_sigma: float) -> Array:
    """Return the (k,) bound for (k,) stars without interpolation."""
    phase = (np.arange(PHASES) + 0.5) / PHASES - 0.5
    reach = int(np.ceil(REACH_SIGMAS * sigma_px)) + 1
    edge = np.arange(-reach, reach + 2) - 0.5
    z = (edge - phase[:, None]) / sigma_px
    share = np.diff(ndtr(z), axis=-1)
    slope = -np.diff(np.exp(-z * z / 2), axis=-1) / (sigma_px * np.sqrt(2 * np.pi))
    p = np.einsum("ax,by->abxy", share, share).reshape(-1)
    d2 = (np.einsum("ax,by->abxy", slope, share) ** 2).reshape(-1)
    e = np.asarray(star_e, float)[:, None]
    variance = e * p + noise_e**2 + (response_sigma * e * p) ** 2
    information = (e**2 * d2 / np.maximum(variance, 1e-300)).sum(axis=1) / PHASES**2
    return np.asarray(1 / np.sqrt(np.maximum(information, 1e-300)))


def pixel_bias_px(sigma_px: Array | float) -> Array:
    """Return the systematic error of an uncorrected centre of light, rms over the pixel.

    First term of the Fourier series of the interpolation error of a Gaussian star, e^(−2π²σ²)/π · sin 2πδ (Moniteq 1983
    eq. 4.6 untruncated).
    """
    return np.asarray(np.exp(-2 * (np.pi * np.asarray(sigma_px, float)) ** 2) / (np.pi * np.sqrt(2)))


def centroid_sigma_px(camera: DesignCamera, v_mag: Array | float) -> Array:
    """Return the centroid bound for stars of magnitude V in this camera."""
    star_e = camera.sensor.star_e(v_mag, camera.exposure_s)
    return bound_px(star_e, camera.psf_sigma_px, camera.noise_e, camera.response_sigma)


def psf_advice(camera: DesignCamera) -> PsfAdvice:
    """Compute the effect of a different focus: magnitude limits, and the centroid error of the faintest star used at
    the present focus, with noise and pixel bias combined."""
    tried = [with_psf(camera, float(s)) for s in PSF_GRID_PX]
    star_e = np.array([float(camera.sensor.star_e(limit_mag(camera), camera.exposure_s))])
    noise = np.array([exact_bound_px(star_e, t.psf_sigma_px, t.noise_e, t.response_sigma)[0] for t in tried])
    best = float(PSF_GRID_PX[int(np.argmin(np.hypot(noise, pixel_bias_px(PSF_GRID_PX))))])
    return PsfAdvice(
        PSF_GRID_PX,
        np.array([limit_brightest_pixel_mag(t) for t in tried]),
        np.array([limit_window_mag(t) for t in tried]),
        np.hypot(noise, pixel_bias_px(PSF_GRID_PX)),
        best,
        psf_kind(camera.psf_sigma_px, best),
    )

"""Magnitude limits from signal and noise of a Gaussian star on pixels, using our zero point."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import numpy as np
from scipy.special import ndtr

from gss.catalogue_tools.design.camera import DesignCamera
from gss.domain.angles import Array

PHASES = 9
BLUR_LOSS_MAG = 0.5
MAX_STREAK_PX = 1e4
PSF_GRID_PX = np.round(np.geomspace(0.25, 4.0, 25), 4)


def column_shares(offset_px: Array | float, sigma_px: float, window_px: int) -> Array:
    """Return the (…, N) fraction of a star's light in each of N columns if the star is ``offset_px`` from the middle of
    the window."""
    edge = np.arange(window_px + 1) - window_px / 2
    return np.asarray(np.diff(ndtr((edge - np.asarray(offset_px, float)[..., None]) / sigma_px), axis=-1))


def brightest_pixel_share(sigma_px: float, streak_px: float = 0.0, centred: bool = False) -> float:
    """Return the fraction of a star's light in its brightest pixel: averaged over the position within the pixel, or at
    the centre, where it is largest.

    ``streak_px``: length of uniform motion along the columns during the exposure; the streak is centred.
    """
    u = np.zeros(1) if centred else (np.arange(PHASES) + 0.5) / PHASES - 0.5
    still = ndtr((0.5 - u) / sigma_px) - ndtr((-0.5 - u) / sigma_px)
    if streak_px <= 0:
        return float(np.mean(still) ** 2)
    half = streak_px / 2

    def reached(x: Array) -> Array:
        """∫ Φ(x/σ) dx."""
        z = x / sigma_px
        return np.asarray(x * ndtr(z) + sigma_px * np.exp(-z * z / 2) / np.sqrt(2 * np.pi))

    upper = reached(0.5 - u + half) - reached(0.5 - u - half)
    lower = reached(-0.5 - u + half) - reached(-0.5 - u - half)
    return float(np.mean((upper - lower) / streak_px) * np.mean(still))


@lru_cache(maxsize=256)
def energy_window(sigma_px: float) -> tuple[int, float]:
    """Return the window that maximises the signal-to-noise ratio of a centred star over uniform noise: its side N in
    pixels, and the fraction of the star's light in it."""
    sizes = np.arange(1, 2 * int(np.ceil(3 * sigma_px)) + 3)
    shares = np.array([float(column_shares(0.0, sigma_px, int(n)).sum()) ** 2 for n in sizes])
    best = int(np.argmax(shares / sizes))
    return int(sizes[best]), float(shares[best])


def snr_brightest_pixel(camera: DesignCamera, v_mag: Array | float) -> Array:
    """Signal-to-noise ratio of a star's brightest pixel: S/√(S + D + R² + Δ²/12 + B) (Huffman 2006 eq. 3.17)."""
    s = camera.sensor.star_e(v_mag, camera.exposure_s) * brightest_pixel_share(camera.psf_sigma_px)
    return np.asarray(s / np.sqrt(s + camera.noise_e**2))


def snr_window(camera: DesignCamera, v_mag: Array | float) -> Array:
    """Signal-to-noise ratio of all the light in the window of :func:`energy_window`."""
    side, share = energy_window(camera.psf_sigma_px)
    s = camera.sensor.star_e(v_mag, camera.exposure_s) * share
    return np.asarray(s / np.sqrt(s + side**2 * camera.noise_e**2))


def signal_for_snr_e(snr: float, noise_e: float) -> float:
    """Electrons S with S/√(S + noise²) = snr."""
    return float(snr * (snr + np.sqrt(snr**2 + 4 * noise_e**2)) / 2)


def limit_brightest_pixel_mag(camera: DesignCamera) -> float:
    """Faintest V whose brightest pixel reaches the threshold, averaged over the star's position within the pixel."""
    needed_e = signal_for_snr_e(camera.threshold_snr, camera.noise_e) / brightest_pixel_share(camera.psf_sigma_px)
    return float(camera.sensor.magnitude(needed_e, camera.exposure_s))


def limit_window_mag(camera: DesignCamera) -> float:
    """Faintest V whose summed window reaches the threshold."""
    side, share = energy_window(camera.psf_sigma_px)
    needed_e = signal_for_snr_e(camera.threshold_snr, side * camera.noise_e) / share
    return float(camera.sensor.magnitude(needed_e, camera.exposure_s))


def limit_mag(camera: DesignCamera) -> float:
    """Return the active magnitude limit. This is the stated limit of the design, or otherwise the limit by the
    brightest pixel, because all five systems compare the brightest pixel with the threshold."""
    return limit_brightest_pixel_mag(camera) if camera.mag_limit is None else camera.mag_limit


def saturation_mag(camera: DesignCamera) -> float:
    """Return the brightest V at which no pixel reaches the full well or the converter limit, for any position within
    the pixel; +inf if the dark signal alone saturates."""
    room_e = camera.brightest_pixel_e
    if room_e <= 0:
        return float("inf")
    return float(
        camera.sensor.magnitude(room_e / brightest_pixel_share(camera.psf_sigma_px, centred=True), camera.exposure_s)
    )


def longest_exposure_s(camera: DesignCamera) -> float:
    """Exposure at which dark current and background alone saturate a pixel."""
    rate = camera.dark_current_e_s + camera.background_e_s
    room_e = min(camera.full_well_e, (camera.sensor.saturation_dn - camera.bias_dn) * camera.gain_e_per_dn)
    return room_e / rate if rate > 0 else float("inf")


@dataclass(frozen=True)
class Blur:
    """Motion limits.

    ``streak_px``: streak length that costs half a magnitude. ``rate_rad_s``: rate about a transverse axis that produces
    this streak. ``smear_limit_rate_rad_s``: rate at which a star moves 0.88 px, the document's tolerable smear (Moniteq
    1983 §4.2).
    """

    streak_px: float
    rate_rad_s: float
    smear_limit_rate_rad_s: float


TOLERABLE_SMEAR_PX = 0.88


def blur_loss_mag(sigma_px: float, streak_px: Array) -> Array:
    """Return the loss of the brightest-pixel limit, in magnitudes, for each streak length."""
    still = brightest_pixel_share(sigma_px, centred=True)
    moving = np.array([brightest_pixel_share(sigma_px, float(s), centred=True) for s in np.ravel(streak_px)])
    return -2.5 * np.log10(moving / still)


def motion_blur(camera: DesignCamera, loss_mag: float = BLUR_LOSS_MAG) -> Blur:
    """Compute the angular rates that the camera tolerates.

    For a faint star, the noise of the sky dominates. Therefore the limit depends only on the fraction of light in the
    brightest pixel.
    """

    def excess(log_streak: float) -> float:
        return float(blur_loss_mag(camera.psf_sigma_px, np.exp(np.array([log_streak])))[0]) - loss_mag

    from scipy.optimize import brentq  # the import takes 10 MB of memory

    streak = float(np.exp(brentq(excess, np.log(1e-3), np.log(MAX_STREAK_PX))))
    per_px = camera.camera.pixel_rad / camera.exposure_s
    return Blur(streak, streak * per_px, TOLERABLE_SMEAR_PX * per_px)


@dataclass(frozen=True)
class PsfAdvice:
    """Effect of the focus for each ``sigma_px``.

    ``limit_brightest_mag``, ``limit_window_mag``: magnitude limit by the brightest pixel and by the window.
    ``centroid_px``: error of the faintest star used at the present focus. ``best_px``: σ with the smallest error.
    ``kind``: class of the present focus: sharp, good or wide.
    """

    sigma_px: Array
    limit_brightest_mag: Array
    limit_window_mag: Array
    centroid_px: Array
    best_px: float
    kind: str


SHARPEST_PX, MAX_OVER_BEST = 0.4, 2.5
"""Limits of a good focus. Below σ = 0.4 px (pixel over σ 2.5, Moniteq 1983 §4.2), the pixels bias a centre of light.
Above 2.5 times the best σ, spreading the light is useful only if the response within the pixels is non-uniform."""


def psf_kind(sigma_px: float, best_px: float) -> str:
    """Classify the focus as sharp, good or wide."""
    if sigma_px < SHARPEST_PX:
        return "sharp"
    return "wide" if sigma_px > MAX_OVER_BEST * max(best_px, SHARPEST_PX) else "good"


def with_psf(camera: DesignCamera, sigma_px: float) -> DesignCamera:
    """Return the same camera with a different focus."""
    return replace(camera, psf_sigma_px=sigma_px)

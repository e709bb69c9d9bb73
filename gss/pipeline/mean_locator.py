"""Mean locator: centroid of a star in a small window, with systematic error and noise (Moniteq 1983 §4.1–4.3).

The star is a separable Gaussian of standard deviation σ on pixels of width d; ``ratio`` is d/σ. Windows are N x N
pixels. Formulas of the document that disagree with direct integration are corrected here.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from gss.domain.angles import Array

FIT_POINTS = 401


def window_positions(window_px: int) -> Array:
    """Return the (N,) pixel centres relative to the window's middle, which is a pixel centre for odd N and a pixel edge
    for even N."""
    return np.arange(window_px, dtype=float) - (window_px - 1) / 2


def column_shares(offset_px: Array | float, ratio: float, window_px: int) -> Array:
    """Return the (…, N) shares of a star's light in the columns of the window, for a star ``offset_px`` from the
    window's middle."""
    edge = np.arange(window_px + 1) - window_px / 2
    reached = ndtr((edge - np.asarray(offset_px, float)[..., None]) * ratio)
    return np.asarray(np.diff(reached, axis=-1))


def location_error_px(offset_px: Array | float, ratio: float, window_px: int) -> Array:
    """Return E/d, the computed minus the true position without noise, caused by interpolation and truncation (Moniteq
    1983 eq. 4.8)."""
    shares = column_shares(offset_px, ratio, window_px)
    return np.asarray((shares @ window_positions(window_px)) / shares.sum(axis=-1) - offset_px)


def bias_gain(ratio: float, window_px: int) -> float:
    """Return the linear bias corrector of §4.2: the factor for the measured offset that minimises the squared error
    over stars within half a pixel of the window's middle. The document does not state its value."""
    offset = np.linspace(-0.5, 0.5, FIT_POINTS)
    measured = offset + location_error_px(offset, ratio, window_px)
    return float((measured @ offset) / (measured @ measured))


@dataclass(frozen=True)
class NoiseCoefficients:
    """Coefficients of σ²(P) = A σ²(G) + B/Q + (C/Q²)(f²i²τ² + σ²(R) + iτ), in px² (Moniteq 1983 §4.3)."""

    a: float
    b: float
    c: float


def noise_coefficients(offset_px: tuple[float, float], ratio: float, window_px: int) -> NoiseCoefficients:
    """Return A, B and C along the first axis for a star at offset (x, y) from the window's middle. Lever arms are
    measured from the biased centroid."""
    position = window_positions(window_px)
    x, y = (column_shares(np.array(o), ratio, window_px) for o in offset_px)
    w = np.outer(y, x)
    inside = float(w.sum())
    arm2 = (position - (x @ position) / x.sum()) ** 2
    return NoiseCoefficients(
        float((arm2 * w**2).sum() / inside**2),
        float((arm2 * w).sum() / inside**2),
        float(arm2.sum() * window_px / inside**2),
    )


@dataclass(frozen=True)
class DarkModel:
    """Sensor terms of the noise model: ``response_sigma`` σ(G), ``dark_e_s`` i, ``dark_share`` f, ``read_e2`` σ²(R)."""

    response_sigma: float
    dark_e_s: float
    dark_share: float
    read_e2: float

    def position_sigma_px(self, n: NoiseCoefficients, star_e: float, exposure_s: float) -> float:
        """Return the standard deviation of one coordinate of a star with ``star_e`` electrons."""
        dark_e = self.dark_e_s * exposure_s
        third = (self.dark_share * dark_e) ** 2 + self.read_e2 + dark_e
        return float(np.sqrt(n.a * self.response_sigma**2 + n.b / star_e + n.c / star_e**2 * third))


def mean_locations_px(stamps: Array, dark_dn: float) -> tuple[Array, Array, Array]:
    """Return (m,) offsets x and y from the window's middle and fluxes of (m, N, N) stamps, dark mean subtracted."""
    light = stamps - dark_dn
    position = window_positions(stamps.shape[-1])
    flux = np.maximum(light.sum(axis=(1, 2)), 1e-9)
    return (light.sum(axis=1) @ position) / flux, (light.sum(axis=2) @ position) / flux, flux

"""What catalogue magnitude a flux stands for: a robust line through the stars already named."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss.domain.angles import Array

SLOPE_SIGMA = 0.08  # a detector is linear; a photograph processed for the eye is less so
SCATTER_MAG, SCATTER_STARS = 0.35, 4.0  # what colour and filter usually do, and how many stars that experience is worth
LEAST_SCATTER_MAG = 0.05
ROUNDS = 8


@dataclass(frozen=True)
class FluxLine:
    """V = ``level`` + ``slope`` · (m − ``middle``) for an instrumental magnitude m, with the scatter of single stars about it."""

    level: float
    slope: float
    middle: float
    level_sigma: float
    slope_sigma: float
    scatter: float

    def v_mag(self, magnitude: Array) -> Array:
        """Catalogue magnitudes of instrumental ones."""
        return np.asarray(self.level + self.slope * (magnitude - self.middle))

    def sigma(self, magnitude: Array) -> Array:
        """Standard deviation of a star about the line there: its own scatter and the line's error, photon noise not included."""
        away = self.slope_sigma * (magnitude - self.middle)
        return np.asarray(np.sqrt(self.scatter**2 + self.level_sigma**2 + away**2))


def flux_line(magnitude: Array, v_mag: Array, sigma: Array) -> FluxLine:
    """Fit (n ≥ 1) stars of instrumental ``magnitude`` with photon noise ``sigma`` to their catalogue magnitudes.

    Cauchy weights, because saturated and blended stars lie far off on one side. The slope is held near 1 until stars say otherwise.
    """
    middle = float(np.median(magnitude))
    away = magnitude - middle
    level, slope = float(np.median(v_mag - away)), 1.0
    scatter = SCATTER_MAG
    normal = np.eye(2)
    for _ in range(ROUNDS):
        residual = v_mag - level - slope * away
        total = np.sqrt(scatter**2 + sigma**2)
        weight = 1 / (total**2 * (1 + (residual / (2 * total)) ** 2))
        j = np.column_stack([np.ones_like(away), away])
        normal = j.T @ (weight[:, None] * j) + np.diag([0.0, SLOPE_SIGMA**-2])
        step = np.linalg.solve(normal, j.T @ (weight * residual) + [0.0, (1 - slope) / SLOPE_SIGMA**2])
        level, slope = level + float(step[0]), slope + float(step[1])
        scatter = _scatter(v_mag - level - slope * away, sigma)
    covariance = np.linalg.inv(normal)
    return FluxLine(level, slope, middle, float(np.sqrt(covariance[0, 0])), float(np.sqrt(covariance[1, 1])), scatter)


def _scatter(residual: Array, sigma: Array) -> float:
    """Robust scatter beyond photon noise, drawn towards experience while there are few stars."""
    n = len(residual)
    seen = (1.4826 * float(np.median(np.abs(residual)))) ** 2 - float(np.median(sigma**2))
    mixed = (n * max(seen, 0.0) + SCATTER_STARS * SCATTER_MAG**2) / (n + SCATTER_STARS)
    return max(float(np.sqrt(mixed)), LEAST_SCATTER_MAG)

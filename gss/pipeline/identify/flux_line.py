"""What catalogue magnitude a flux stands for: a robust line through the stars already named."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gss.domain.angles import Array
from gss.pipeline.small import median

SLOPE_SIGMA = 0.08  # a detector is linear; a photograph processed for the eye is less so
SCATTER_MAG, SCATTER_STARS = 0.35, 4.0  # what colour and filter usually do, and how many stars that experience is worth
LEAST_SCATTER_MAG = 0.05
ROUNDS = 8
SETTLED_MAG = 1e-3  # a thirtieth of the narrowest window would not matter


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
    middle = median(magnitude)
    away = magnitude - middle
    level, slope = median(v_mag - away), 1.0
    scatter, photons2 = SCATTER_MAG, sigma * sigma
    typical2, prior = median(photons2), SLOPE_SIGMA**-2
    for _ in range(ROUNDS):
        residual = v_mag - level - slope * away
        total2 = scatter**2 + photons2
        weight = 1 / (total2 + residual * residual / 4)
        pull = weight * away
        # Two unknowns: level and slope.
        one, cross, lever = float(weight.sum()), float(pull.sum()), float(pull @ away) + prior
        left, right = float(weight @ residual), float(pull @ residual) + (1 - slope) * prior
        determinant = one * lever - cross * cross
        up, steeper = (lever * left - cross * right) / determinant, (one * right - cross * left) / determinant
        level, slope, before = level + up, slope + steeper, scatter
        scatter = _scatter(v_mag - level - slope * away, typical2)
        if max(abs(up), abs(steeper), abs(scatter - before)) < SETTLED_MAG:
            break
    return FluxLine(level, slope, middle, math.sqrt(lever / determinant), math.sqrt(one / determinant), scatter)


def _scatter(residual: Array, photons2: float) -> float:
    """Robust scatter beyond photon noise of that typical variance, drawn towards experience while there are few stars."""
    n = len(residual)
    seen = (1.4826 * median(np.abs(residual))) ** 2 - photons2
    mixed = (n * max(seen, 0.0) + SCATTER_STARS * SCATTER_MAG**2) / (n + SCATTER_STARS)
    return max(math.sqrt(mixed), LEAST_SCATTER_MAG)

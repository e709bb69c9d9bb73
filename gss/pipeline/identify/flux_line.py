"""Conversion of instrumental to catalogue magnitude: a robust line through the stars already identified."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from gss.domain.angles import Array
from gss.pipeline.small import median

SLOPE_SIGMA = 0.08  # prior sigma of the slope about 1; the slope differs from 1 mostly in processed photographs
SCATTER_MAG, SCATTER_STARS = 0.35, 4.0  # prior scatter caused by colour and filter, and its weight as a number of stars
MIN_SCATTER_MAG = 0.05
ROUNDS = 8
SETTLED_MAG = 1e-3  # convergence limit, far below a thirtieth of the narrowest window


@dataclass(frozen=True)
class FluxLine:
    """Line V = ``level`` + ``slope`` · (m − ``middle``) for an instrumental magnitude m; ``scatter``: of single stars
    about the line."""

    level: float
    slope: float
    middle: float
    level_sigma: float
    slope_sigma: float
    scatter: float

    def v_mag(self, magnitude: Array) -> Array:
        """Convert instrumental to catalogue magnitudes."""
        return np.asarray(self.level + self.slope * (magnitude - self.middle))

    def sigma(self, magnitude: Array) -> Array:
        """Return the standard deviation of a star about the line: scatter and error of the line, without photon noise."""
        away = self.slope_sigma * (magnitude - self.middle)
        return np.asarray(np.sqrt(self.scatter**2 + self.level_sigma**2 + away**2))


def flux_line(magnitude: Array, v_mag: Array, sigma: Array) -> FluxLine:
    """Fit (n ≥ 1) stars of instrumental ``magnitude`` with photon noise ``sigma`` to their catalogue magnitudes.

    Uses Cauchy weights because saturated and blended stars are outliers on one side. A prior keeps the slope near 1 unless the
    stars determine it.
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
        # Normal equations for two unknowns: level and slope.
        total_weight, cross, lever = float(weight.sum()), float(pull.sum()), float(pull @ away) + prior
        level_sum, slope_sum = float(weight @ residual), float(pull @ residual) + (1 - slope) * prior
        determinant = total_weight * lever - cross * cross
        up, steeper = (
            (lever * level_sum - cross * slope_sum) / determinant,
            (total_weight * slope_sum - cross * level_sum) / determinant,
        )
        level, slope, before = level + up, slope + steeper, scatter
        scatter = _scatter(v_mag - level - slope * away, typical2)
        if max(abs(up), abs(steeper), abs(scatter - before)) < SETTLED_MAG:
            break
    return FluxLine(
        level, slope, middle, math.sqrt(lever / determinant), math.sqrt(total_weight / determinant), scatter
    )


def _scatter(residual: Array, photons2: float) -> float:
    """Return the robust scatter that exceeds the photon noise with variance ``photons2``. With few stars, the prior
    contributes to the result."""
    n = len(residual)
    observed2 = (1.4826 * median(np.abs(residual))) ** 2 - photons2
    mixed = (n * max(observed2, 0.0) + SCATTER_STARS * SCATTER_MAG**2) / (n + SCATTER_STARS)
    return max(math.sqrt(mixed), MIN_SCATTER_MAG)

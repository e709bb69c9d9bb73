"""Level and noise of the sky in night photographs, and the gain if both vary.

Because of shot noise, the variance of a pixel increases with its level. The slope of this relation is 1/gain. Without
dark frames the bias is unknown, so only the slope is used.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.pipeline.background import SAMPLES_PER_TILE, Background, measure_background
from gss.pipeline.calibration.robust import fit_linear, robust_sigma

SURE_SIGMAS = 5.0
MIN_TILES = 30
NEIGHBOURS = 9
"""Number of tiles that contribute to each value of the background mesh. The values are medians of nine tiles, so
neighbouring values are correlated."""
STARS_LEVEL, STARS_GAIN = 0.05, 0.02
"""Error caused by stars that are too faint to be clipped: error of the level in units of the noise, and relative error
of the gain. Measured in simulated photographs."""
LEVEL_RANGE = 0.05
"""Minimum range of levels, relative to the highest level, that determines the gain."""


@dataclass(frozen=True)
class SkyFigures:
    """Statistics of the sky. ``level_dn`` ± ``level_sigma`` and ``noise_dn`` ± ``noise_sigma`` of a pixel in the
    darkest photograph; ``excess_dn`` ± ``excess_sigma``: median level of the photographs minus the darkest
    level. ``gain_e_per_dn`` ±
    ``gain_sigma``: NaN if the level varies too little. ``largest_dn``: largest pixel value, reached by
    ``largest_count`` pixels."""

    level_dn: float
    level_sigma: float
    noise_dn: float
    noise_sigma: float
    excess_dn: float
    excess_sigma: float
    gain_e_per_dn: float
    gain_sigma: float
    largest_dn: float
    largest_count: int


def sky_figures(images: Sequence[NDArray[Any]], *, linear: bool) -> SkyFigures:
    """Measure (rows, columns) images. ``linear``: False for files whose values are not proportional to the light (JPEG, colour),
    from which no gain is derived."""
    meshes = [measure_background(image) for image in images]
    levels = np.array([float(np.median(m.level)) for m in meshes])
    darkest = meshes[int(np.argmin(levels))]
    independent = float(np.sqrt(max(darkest.level.size / NEIGHBOURS, 1.0)))
    gain, gain_sigma = _gain(meshes) if linear else (float("nan"), float("nan"))
    largest = max(float(image.max()) for image in images)
    noise_dn = float(np.median(darkest.noise))
    # measure_background sets a uniform mesh to its mean. Then the spread of the tiles is zero, and only the noise of the
    # samples contributes.
    tile_sigma = float(np.hypot(robust_sigma(darkest.level.ravel()), noise_dn / np.sqrt(SAMPLES_PER_TILE)))
    level_sigma = float(np.hypot(tile_sigma / independent, STARS_LEVEL * noise_dn))
    spread = robust_sigma(levels) if len(levels) > 1 else 0.0
    return SkyFigures(
        float(levels.min()),
        level_sigma,
        noise_dn,
        float(np.hypot(robust_sigma(darkest.noise.ravel()), noise_dn / np.sqrt(2 * SAMPLES_PER_TILE))) / independent,
        float(np.median(levels) - levels.min()),
        float(np.hypot(1.25 * spread / np.sqrt(len(levels)), level_sigma)),
        gain,
        gain_sigma,
        largest,
        sum(int(np.count_nonzero(image == largest)) for image in images),
    )


def _gain(meshes: Sequence[Background]) -> tuple[float, float]:
    level: Array = np.concatenate([m.level.ravel() for m in meshes])
    variance: Array = np.concatenate([m.noise.ravel() ** 2 for m in meshes])
    if len(level) < MIN_TILES or np.ptp(level) < LEVEL_RANGE * abs(float(level.max())):
        return float("nan"), float("nan")
    fit = fit_linear(np.column_stack([np.ones(len(level)), level - level.mean()]), variance)
    slope = float(fit.coefficients[1])
    sigma = float(np.sqrt(fit.covariance[1, 1] * NEIGHBOURS))
    if slope <= SURE_SIGMAS * sigma:
        return float("nan"), float("nan")
    return 1 / slope, float(np.hypot(sigma / slope**2, STARS_GAIN / slope))

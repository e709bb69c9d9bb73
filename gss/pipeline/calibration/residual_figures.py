"""Residuals between measured and predicted star positions: statistics, and maps over the detector."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array

MAP_CELLS = 12


@dataclass(frozen=True)
class ResidualFigures:
    """Statistics of residuals. ``rms_px``: per axis; ``noise_px``: rms corrected for the fitted degrees of freedom,
    which is the scatter of one measured star; ``median_px``, ``p95_px``, ``max_px``: median, 95 % quantile and maximum
    of the lengths of the residuals; ``chi``: rms in units of the stated σ of the stars; ``rejected``: number of
    rejected stars."""

    stars: int
    rms_px: float
    noise_px: float
    median_px: float
    p95_px: float
    max_px: float
    chi: float
    rejected: int


def residual_figures(
    residual_px: Array, sigma_px: Array, used: NDArray[np.bool_], freedom: int | None = None
) -> ResidualFigures:
    """Compute the statistics of (n, 2) residuals. ``freedom``: equations minus unknowns, None without a fit."""
    r, n = residual_px[used], int(used.sum())
    if not n:
        nan = float("nan")
        return ResidualFigures(0, nan, nan, nan, nan, nan, nan, len(used))
    length = np.hypot(r[:, 0], r[:, 1])
    rms = float(np.sqrt(np.mean(r**2)))
    noise = rms if freedom is None else rms * float(np.sqrt(2 * n / max(freedom, 1)))
    chi = float(np.sqrt(np.mean((r / sigma_px[used, None]) ** 2)))
    median, p95 = (float(x) for x in np.percentile(length, [50, 95]))
    return ResidualFigures(n, rms, noise, median, p95, float(length.max()), chi, len(used) - n)


@dataclass(frozen=True)
class ResidualMap:
    """Residuals binned over the detector. ``col_px`` (c,), ``row_px`` (r,): centres of the cells. ``mean_px``: (r, c, 2) mean
    vector, ``rms_px``: (r, c) per axis, ``count``: (r, c). NaN for cells without stars."""

    col_px: Array
    row_px: Array
    mean_px: Array
    rms_px: Array
    count: NDArray[np.intp]


def residual_map(pixels: Array, residual_px: Array, size: tuple[int, int], cells: int = MAP_CELLS) -> ResidualMap:
    """Bin (n, 2) positions and residuals on a detector of ``size`` (columns, rows). Cells are nearly square, with
    ``cells`` on the long side."""
    columns, rows = size
    step = max(columns, rows) / cells
    across, down = max(1, round(columns / step)), max(1, round(rows / step))
    c = np.clip(((pixels[:, 0] + 0.5) * across / columns).astype(int), 0, across - 1)
    r = np.clip(((pixels[:, 1] + 0.5) * down / rows).astype(int), 0, down - 1)
    cell = r * across + c
    count = np.bincount(cell, minlength=across * down)
    with np.errstate(invalid="ignore", divide="ignore"):
        mean = np.stack([np.bincount(cell, residual_px[:, k], across * down) / count for k in (0, 1)], axis=-1)
        rms = np.sqrt(np.bincount(cell, (residual_px**2).mean(axis=1), across * down) / count)
    return ResidualMap(
        (np.arange(across) + 0.5) * columns / across - 0.5,
        (np.arange(down) + 0.5) * rows / down - 0.5,
        mean.reshape(down, across, 2),
        rms.reshape(down, across),
        count.reshape(down, across),
    )

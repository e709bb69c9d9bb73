"""Robust linear fits of data with outliers, with Huber weights and the corresponding covariance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.errors import BadInput

HUBER = 2.0
REJECT = 5.0
ROUNDS = 30
NORMAL_MAD = 1.4826


@dataclass(frozen=True)
class Linear:
    """Result of a linear fit. ``coefficients`` (p,), ``covariance`` (p, p), ``residual`` (n,) data − model, ``used``
    (n,); ``sigma``: scatter in units of the data's stated errors."""

    coefficients: Array
    covariance: Array
    residual: Array
    used: NDArray[np.bool_]
    sigma: float


def robust_sigma(values: Array) -> float:
    """Return the standard deviation of normally distributed values, from the median absolute deviation."""
    v = values[np.isfinite(values)]
    return float(NORMAL_MAD * np.median(np.abs(v - np.median(v)))) if len(v) else float("nan")


def fit_linear(design: Array, data: Array, sigma: Array | None = None) -> Linear:
    """Fit (n,) data to (n, p) columns by robust least squares. Outliers beyond 5 σ of the scatter are rejected. Raises
    BadInput for too few data or a σ that is not positive."""
    n, p = design.shape
    if n <= p:
        raise BadInput("too few points for this fit", expected=f"more than {p}", got=str(n))
    scale = np.ones(n) if sigma is None else np.asarray(sigma, float)
    if not (scale > 0).all():
        raise BadInput("a standard deviation is not positive", expected="> 0", got=f"{scale.min():g}")
    weight, used = 1 / scale**2, np.ones(n, bool)
    coefficients = np.zeros(p)
    size = np.linalg.norm(design, axis=0)
    size = np.where(size > 0, size, 1.0)
    for _ in range(ROUNDS):
        root = np.sqrt(np.where(used, weight, 0.0))
        new = np.linalg.lstsq(design / size * root[:, None], data * root, rcond=None)[0] / size
        settled = np.allclose(new, coefficients, rtol=1e-10, atol=1e-14)
        coefficients = new
        residual = data - design @ coefficients
        scaled = np.abs(residual) / scale
        spread = max(NORMAL_MAD * float(np.median(scaled)) * float(np.sqrt(n / (n - p))), 1e-12)
        used = scaled < REJECT * spread
        weight = np.minimum(1.0, HUBER * spread / np.maximum(scaled, 1e-300)) / scale**2
        if settled:
            break
    used_residuals = scaled[used]
    scatter = float(np.sqrt(np.sum(used_residuals**2) / max(len(used_residuals) - p, 1)))
    shaped = (design[used] / size).T @ (design[used] / size / scale[used, None] ** 2)
    covariance = np.linalg.pinv(shaped) * scatter**2 / np.outer(size, size)
    return Linear(coefficients, covariance, residual, used, scatter)

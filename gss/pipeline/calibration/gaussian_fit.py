"""Fit of elliptical, pixel-integrated Gaussians to single bright stars."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.pipeline.detect import Detections
from gss.pipeline.psf import Stamps, adaptive_shapes, cut_stamps

MAX_ITERATIONS = 25
PIXEL_VARIANCE = 1 / 12  # added to the second moment by integration over a pixel
SAMPLES = 3  # number of sampling points of the model per side of a pixel
MAX_MISFIT = 0.25  # largest rms residual as a fraction of the fitted peak


@dataclass(frozen=True)
class Spot:
    """Fit of one star. ``sigma_px``: σ of a round Gaussian with the same area, without the integration over pixels.
    ``ratio``: long to short axis. ``direction_rad``: direction of the long axis."""

    col_px: float
    row_px: float
    sigma_px: float
    ratio: float
    direction_rad: float

    @property
    def covariance_px2(self) -> Array:
        """Return the (2, 2) second moments of the fitted Gaussian, without the integration over pixels."""
        long = np.array([np.cos(self.direction_rad), np.sin(self.direction_rad)])
        return self.sigma_px**2 * (np.eye(2) / self.ratio + (self.ratio - 1 / self.ratio) * np.outer(long, long))


def fit_spots(image: NDArray[Any], detections: Detections, saturation_dn: float, snr: float) -> list[Spot]:
    """Fit the stars of a frame that are bright, complete, unsaturated and isolated."""
    c = detections.centroids
    width = max(detections.psf_sigma_px, 0.6)
    half = int(np.clip(np.ceil(4.0 * width), 3, 14))
    col, row = np.rint(c.col_px).astype(np.intp), np.rint(c.row_px).astype(np.intp)
    inside = (col >= half) & (row >= half) & (col < image.shape[1] - half) & (row < image.shape[0] - half)
    gap2 = (c.col_px[:, None] - c.col_px) ** 2 + (c.row_px[:, None] - c.row_px) ** 2
    np.fill_diagonal(gap2, np.inf)
    isolated = gap2.min(axis=1, initial=np.inf) > (2.5 * half) ** 2
    chosen = np.flatnonzero(inside & isolated)
    if not len(chosen):
        return []
    stamps = cut_stamps(image, col[chosen], row[chosen], np.zeros(len(chosen)), half, saturation_dn)
    ring = np.hypot(stamps.dx, stamps.dy) > 0.85 * half
    sky = np.median(stamps.value[:, ring], axis=1)
    noise = 1.4826 * np.median(np.abs(stamps.value[:, ring] - sky[:, None]), axis=1)
    stamps = Stamps(stamps.col, stamps.row, stamps.dx, stamps.dy, stamps.value - sky[:, None], stamps.use)
    peak = stamps.value.max(axis=1)
    good = stamps.use.all(axis=1) & (peak > snr * np.maximum(noise, 0.3))
    shapes = adaptive_shapes(stamps, width)
    spots = [_fit(stamps, k, shapes.covariance[k]) for k in np.flatnonzero(good & shapes.good).tolist()]
    return [s for s in spots if s is not None]


def _fit(stamps: Stamps, k: int, covariance: Array) -> Spot | None:
    """Fit peak, position, three second moments and sky by Gauss–Newton. Returns None if the fit does not converge,
    moves away from the centre or leaves large residuals."""
    value = stamps.value[k]
    start = covariance - PIXEL_VARIANCE * np.eye(2)
    a, d = max(start[0, 0], 0.1), max(start[1, 1], 0.1)
    theta = np.array([value.max(), 0.0, 0.0, a, d, float(np.clip(start[0, 1], -0.8, 0.8) * 0.5), 0.0])
    weight = 1 / (1 + np.maximum(value, 0) / max(float(value.max()), 1e-9) * 20)
    points = _sampling_points(stamps)
    for _ in range(MAX_ITERATIONS):
        modelled, jacobian = _model(points, theta)
        normal = jacobian.T @ (weight[:, None] * jacobian)
        damp = 1e-6 * np.diag(np.diag(normal)) + 1e-12 * np.eye(7)
        step = np.linalg.solve(normal + damp, jacobian.T @ (weight * (value - modelled)))
        step = np.clip(
            step, -np.array([1e9, 0.5, 0.5, 0.4, 0.4, 0.3, 1e9]), np.array([1e9, 0.5, 0.5, 0.4, 0.4, 0.3, 1e9])
        )
        theta = theta + step
        theta[3:5] = np.maximum(theta[3:5], 0.02)
        theta[5] = np.clip(theta[5], -0.95, 0.95) if theta[3] * theta[4] > theta[5] ** 2 else 0.0
        if np.abs(step[1:6]).max() < 1e-4:
            break
    else:
        return None
    residual = value - _model(points, theta)[0]
    if theta[0] <= 0 or np.hypot(theta[1], theta[2]) > 2 or np.sqrt(np.mean(residual**2)) > MAX_MISFIT * theta[0]:
        return None
    moments, vectors = np.linalg.eigh(np.array([[theta[3], theta[5]], [theta[5], theta[4]]]))
    if moments[0] <= 0:
        return None
    long = vectors[:, 1]
    return Spot(
        float(stamps.col[k] + theta[1]),
        float(stamps.row[k] + theta[2]),
        float((moments[0] * moments[1]) ** 0.25),
        float(np.sqrt(moments[1] / moments[0])),
        float(np.arctan2(long[1], long[0]) % np.pi),
    )


def _sampling_points(stamps: Stamps) -> tuple[Array, Array]:
    """Return the offsets of the sampling points from the centre of the stamp, to the right and down, as (SAMPLES², n)
    for n pixels."""
    offsets = (np.arange(SAMPLES) - (SAMPLES - 1) / 2) / SAMPLES
    right, down = (grid.reshape(-1, 1) for grid in np.meshgrid(offsets, offsets))
    return stamps.dx + right, stamps.dy + down


def _model(points: tuple[Array, Array], theta: Array) -> tuple[Array, Array]:
    """Return (n,) values and (n, 7) derivatives of a Gaussian with peak, position, (xx, yy, xy) and sky, averaged over
    the sampling points of each pixel."""
    peak, x, y, xx, yy, xy, sky = theta
    det = max(xx * yy - xy * xy, 1e-6)
    ax, ay = points[0] - x, points[1] - y
    along, across = (yy * ax - xy * ay) / det, (xx * ay - xy * ax) / det
    square = along * ax + across * ay
    share = np.exp(-0.5 * square)
    light = peak * share
    parts = (
        share,
        light * along,
        light * across,
        light * 0.5 * (square * yy - ay * ay) / det,
        light * 0.5 * (square * xx - ax * ax) / det,
        light * (ax * ay - square * xy) / det,
    )
    columns = [part.mean(axis=0) for part in parts]
    return peak * columns[0] + sky, np.stack([*columns, np.ones(len(columns[0]))], axis=1)

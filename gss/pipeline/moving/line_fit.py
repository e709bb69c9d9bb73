"""Fit of one light source as a line, i.e. as a point-spread function moved from one end to the other."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.pipeline.trail_shape import trailed_gaussian

ROUNDS = 20
DONE_CHI2 = 0.02
POINT = (0, 1, 2)
LINE = (0, 1, 2, 3, 4)
WIDTH = 5
ENDS = np.array([[[1.0, 0.0, -0.5, 0.0], [0.0, 1.0, 0.0, -0.5]], [[1.0, 0.0, 0.5, 0.0], [0.0, 1.0, 0.0, 0.5]]])
"""Derivatives (end, axis, parameter) of the two ends with respect to centre and trail."""


@dataclass(frozen=True)
class Cutout:
    """Pixels around one source: (k,) offsets in px from the middle (col, row), values above the sky, variance of a sky pixel,
    and electrons per digital number (0: without shot noise)."""

    dx: Array
    dy: Array
    value: Array
    variance: float
    e_per_dn: float


@dataclass(frozen=True)
class LineFit:
    """Fitted source. ``centre_px`` (2,) from the middle of the cut-out; ``trail_px`` (2,) from one end to the other,
    with arbitrary sign, zero for a point; ``variance_px2`` of the point-spread function; ``covariance`` (4, 4) of
    centre and trail, px², zero for parameters that were not fitted."""

    centre_px: Array
    trail_px: Array
    variance_px2: float
    flux_dn: float
    flux_sigma_dn: float
    covariance: Array
    chi2: float
    freedom: int

    @property
    def snr(self) -> float:
        """Return the flux divided by its error."""
        return self.flux_dn / self.flux_sigma_dn

    @property
    def length_px(self) -> float:
        """Return the distance between the ends."""
        return float(np.hypot(*self.trail_px))

    @property
    def length_sigma_px(self) -> float:
        """Return the standard deviation of the length."""
        along = self.trail_px / max(self.length_px, 1e-9)
        return float(np.sqrt(max(float(along @ self.covariance[2:, 2:] @ along), 0.0) * self.excess))

    @property
    def excess(self) -> float:
        """Return the factor by which variances are increased: χ² per degree of freedom, at least 1."""
        return max(self.chi2 / max(self.freedom, 1), 1.0)

    def end_covariance(self) -> Array:
        """Return the (2, 2, 2) covariances of the two ends, px²."""
        return np.asarray(np.einsum("eip,pq,ejq->eij", ENDS, self.covariance, ENDS))


def cut_out(
    image: NDArray[np.float32], noise: float, col: int, row: int, half: int, saturation_dn: float, e_per_dn: float
) -> Cutout:
    """Cut a square of 2·half + 1 pixels from a frame whose sky was subtracted. Saturated pixels and pixels off the
    detector are excluded."""
    top, left = max(row - half, 0), max(col - half, 0)
    part = image[top : row + half + 1, left : col + half + 1]
    y, x = (np.asarray(v) for v in np.indices(part.shape))
    use = part < saturation_dn
    return Cutout(
        (x[use] + left - col).astype(float),
        (y[use] + top - row).astype(float),
        part[use].astype(float),
        noise**2,
        e_per_dn,
    )


def fit_line(cut: Cutout, start: Array, free: tuple[int, ...]) -> LineFit | None:
    """Fit by Levenberg–Marquardt from ``start`` (6,): flux, col, row, trail col, trail row, variance of the
    point-spread function. ``free``: indices of the parameters to fit. Return None if the pixels do not determine these
    parameters."""
    p = np.array(start, float)
    fitted = np.array(free)
    if len(cut.value) <= len(free):
        return None
    damping, longest = 1e-3, 3 * float(max(cut.dx.max(), cut.dy.max(), 1.0))
    model, slopes, weight, chi2 = _state(cut, p)
    normal = np.eye(len(free))
    for _ in range(ROUNDS):
        jacobian = slopes[:, fitted]
        normal = jacobian.T @ (weight[:, None] * jacobian)
        gradient = jacobian.T @ (weight * (cut.value - model))
        scale = np.diag(normal)
        if not np.isfinite(normal).all() or (scale <= 0).any():
            return None
        trial = p.copy()
        trial[fitted] += np.linalg.solve(normal + damping * np.diag(scale), gradient)
        trial[1:5] = np.clip(trial[1:5], -longest, longest)
        trial[WIDTH] = np.clip(trial[WIDTH], 0.5 * p[WIDTH], 2 * p[WIDTH])
        state = _state(cut, trial)
        # With shot noise the weights depend on the model. Therefore χ² before and after a step is computed with the
        # same weights, those before the step.
        after = float((weight * (cut.value - state[0]) ** 2).sum())
        if after > chi2:
            damping *= 10
            if damping > 1e4:
                break
            continue
        converged = chi2 - after < DONE_CHI2
        damping = max(damping / 10, 1e-9)
        p, (model, slopes, weight, chi2) = trial, state
        if converged:
            break
    try:
        inverse = np.linalg.inv(normal)
    except np.linalg.LinAlgError:
        return None
    covariance = np.zeros((6, 6))
    covariance[np.ix_(fitted, fitted)] = inverse
    if not (np.isfinite(inverse).all() and p[0] > 0 and covariance[0, 0] > 0):
        return None
    return LineFit(
        p[1:3],
        p[3:5],
        float(p[WIDTH]),
        float(p[0]),
        float(np.sqrt(covariance[0, 0])),
        covariance[1:5, 1:5],
        chi2,
        len(cut.value) - len(free),
    )


def _state(cut: Cutout, p: Array) -> tuple[Array, Array, Array, float]:
    """Return the (k,) expected values, their (k, 6) derivatives with respect to the parameters, the (k,) weights and χ²."""
    shape, by = trailed_gaussian((cut.dx - p[1])[None], (cut.dy - p[2])[None], p[None, 3:5], float(p[WIDTH]))
    slopes = np.column_stack([shape[0], p[0] * by[0]])
    slopes[:, 1:3] *= -1
    model = p[0] * shape[0]
    shot = np.maximum(model, 0) / cut.e_per_dn if cut.e_per_dn > 0 else np.zeros_like(model)
    weight = 1 / (cut.variance + shot)
    return model, slopes, weight, float((weight * (cut.value - model) ** 2).sum())

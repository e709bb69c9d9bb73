"""Star positions from least-squares fits of one Gaussian point-spread function to all stars of a frame.

All stars share the covariance of the function (pixel integration included). The shape is measured on bright stars and
used for faint stars, so the error of a faint star is close to the Cramér–Rao bound. For trailed stars, the covariance
is elongated.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.pipeline.small import close_pairs

FIT_ROUNDS = 6
MOMENT_ROUNDS = 14
STEP_DONE_PX = 2e-4
MODEL_FLOOR = 0.006  # position error, as a share of the width, because a real lens is not Gaussian

NARROWEST_PX = 0.05


def widths_px(covariance: Array) -> tuple[float, float]:
    """Return the standard deviations along the short and the long axis of a (2, 2) covariance. Both are at least
    ``NARROWEST_PX``, because noise can make a measured variance negative."""
    xx, xy, yy = float(covariance[0, 0]), float(covariance[0, 1]), float(covariance[1, 1])
    middle, off = (xx + yy) / 2, math.hypot((xx - yy) / 2, xy)
    low, high = (math.sqrt(max(v, NARROWEST_PX**2)) for v in (middle - off, middle + off))
    return low, high


@dataclass(frozen=True)
class Stamps:
    """Square cut-outs around stars. ``value``: (n, k) pixels above the sky, ``dx`` ``dy``: (k,) offsets from the
    integer centres ``col`` ``row`` (n,); ``use``: (n, k) False for pixels that are off the detector or saturated."""

    col: NDArray[np.intp]
    row: NDArray[np.intp]
    dx: Array
    dy: Array
    value: Array
    use: NDArray[np.bool_]


def cut_stamps(
    image: NDArray[Any], col: NDArray[np.intp], row: NDArray[np.intp], sky: Array, half: int, saturation: float
) -> Stamps:
    """Cut (2·half+1)² pixels around each of n integer positions and subtract the sky (n,)."""
    side, dx, dy = _offsets(half)
    rows, cols = image.shape
    r, c = row[:, None] + side, col[:, None] + side
    r_in, c_in = np.minimum(np.maximum(r, 0), rows - 1), np.minimum(np.maximum(c, 0), cols - 1)
    flat = (r_in[:, :, None] * cols + c_in[:, None, :]).reshape(len(row), len(side) ** 2)
    raw = image.reshape(-1).take(flat).astype(float)
    use = raw < saturation
    down, across = r == r_in, c == c_in
    if not (down.all() and across.all()):
        use &= (down[:, :, None] & across[:, None, :]).reshape(use.shape)
    return Stamps(col, row, dx, dy, raw - sky[:, None], use)


@lru_cache(maxsize=32)
def _offsets(half: int) -> tuple[NDArray[np.intp], Array, Array]:
    """Return the offsets along one axis, and the x and y offsets of the pixels of a stamp, row by row; read-only."""
    side = np.arange(-half, half + 1)
    dx, dy = np.tile(side.astype(float), len(side)), np.repeat(side.astype(float), len(side))
    for values in (side, dx, dy):
        values.flags.writeable = False
    return side, dx, dy


@dataclass(frozen=True)
class AdaptiveMoments:
    """Adaptive second moments: centres (n,), covariance (n, 2, 2) in px²; ``good`` is True if the iteration converged."""

    col: Array
    row: Array
    covariance: Array
    good: NDArray[np.bool_]


def adaptive_shapes(stamps: Stamps, start_sigma_px: float) -> AdaptiveMoments:
    """Measure each star's width and elongation by moments under an adaptive Gaussian window (Bernstein & Jarvis 2002 §3)."""
    n = len(stamps.col)
    x, y = np.zeros(n), np.zeros(n)
    xx, yy, xy = np.full(n, start_sigma_px**2), np.full(n, start_sigma_px**2), np.zeros(n)
    half = float(stamps.dx.max())
    value = np.where(stamps.use, stamps.value, 0.0)
    for _ in range(MOMENT_ROUNDS):
        ax, ay = stamps.dx - x[:, None], stamps.dy - y[:, None]
        det = xx * yy - xy * xy
        q = (yy[:, None] * ax * ax - 2 * xy[:, None] * ax * ay + xx[:, None] * ay * ay) / det[:, None]
        w = np.exp(-0.5 * q) * value
        total = w.sum(1)
        total = np.where(total > 0, total, np.nan)
        # With a matched window, the measured centroid shift is half of the true shift, and the measured moments are
        # half of the true moments.
        sx, sy = (w * ax).sum(1) / total, (w * ay).sum(1) / total
        x = np.clip(x + np.nan_to_num(2 * sx), -half / 2, half / 2)
        y = np.clip(y + np.nan_to_num(2 * sy), -half / 2, half / 2)
        mxx, myy, mxy = (
            2 * np.nan_to_num((w * a * b).sum(1) / total - s)
            for a, b, s in ((ax, ax, sx * sx), (ay, ay, sy * sy), (ax, ay, sx * sy))
        )
        top = (half / 1.5) ** 2
        xx, yy = np.clip(mxx, 0.08, top), np.clip(myy, 0.08, top)
        limit = 0.98 * np.sqrt(xx * yy)
        xy = np.clip(mxy, -limit, limit)
    covariance = np.stack([np.stack([xx, xy], -1), np.stack([xy, yy], -1)], -2)
    settled = (np.hypot(sx, sy) < 0.05) & (np.hypot(x, y) < max(1.5, half / 2 - 0.1))
    return AdaptiveMoments(
        stamps.col + x, stamps.row + y, covariance, np.asarray(settled & (xx < 0.99 * top) & (yy < 0.99 * top))
    )


Fit = Callable[[Stamps, Array, Array, Array, Array, float], tuple[Array, Array, Array, Array]]


@dataclass(frozen=True)
class PsfFit:
    """Fit of n stars: positions (n,), total flux (n,), standard deviation of a position per axis (n,); ``good`` is True
    if the fit is finite and stayed at its star."""

    col: Array
    row: Array
    flux: Array
    sigma_px: Array
    good: NDArray[np.bool_]


def fit_stars(
    stamps: Stamps,
    start_col: Array,
    start_row: Array,
    covariance: Array,
    noise: Array,
    e_per_dn: float = 0.0,
    fit: Fit | None = None,
) -> PsfFit:
    """Fit position and flux of n stars by Gauss–Newton, each stamp separately.

    ``covariance``: (2, 2) px² of the point-spread function. ``noise``: (n,) standard deviation of a sky pixel.
    ``e_per_dn`` > 0 includes shot noise in the pixel weights. ``fit``: replacement for :func:`fitted`.
    """
    inverse: Array = np.asarray(np.linalg.inv(covariance), float)
    x, y, peak, information = (fit or fitted)(
        stamps, start_col - stamps.col, start_row - stamps.row, inverse, noise, e_per_dn
    )
    area = float(np.sqrt(np.linalg.det(covariance)))
    with np.errstate(invalid="ignore", divide="ignore"):
        sigma = np.sqrt(1 / information + MODEL_FLOOR**2 * area)
    reach = max(2.0, 0.6 * float(stamps.dx.max()))
    good = np.isfinite(peak) & (peak > 0) & np.isfinite(sigma) & (np.hypot(x, y) < reach)
    return PsfFit(stamps.col + x, stamps.row + y, peak * 2 * np.pi * area, sigma, good)


def fitted(
    stamps: Stamps, x: Array, y: Array, inverse: Array, noise: Array, e_per_dn: float
) -> tuple[Array, Array, Array, Array]:
    """Fit n stars from first guesses x (n,) and y (n,) of their offsets from the stamp centres.

    Returns x, y, the peak of the Gaussian, and the information (1/px²) about a position per axis, each (n,).
    ``inverse``: (2, 2) inverse covariance. A star is not iterated further after its step is below ``STEP_DONE_PX``.
    """
    variance = noise[:, None] ** 2
    if e_per_dn > 0:
        variance = variance + np.maximum(stamps.value, 0) / e_per_dn
    weight = stamps.use / variance
    moving = np.ones(len(x), bool)
    for _ in range(FIT_ROUNDS):
        g, gx, gy = _model(stamps, x, y, inverse)
        wg, wx, wy = weight * g, weight * gx, weight * gy
        gg = _dot(wg, g)
        with np.errstate(invalid="ignore", divide="ignore"):
            peak = _dot(wg, stamps.value) / gg
            residual = stamps.value - peak[:, None] * g
            bx, by = _dot(wx, residual), _dot(wy, residual)
            hxx, hyy, hxy = _dot(wx, gx), _dot(wy, gy), _dot(wx, gy)
            det = (hxx * hyy - hxy * hxy) * peak
            step = np.stack([hyy * bx - hxy * by, hxx * by - hxy * bx]) / det
        step = np.minimum(np.maximum(np.where(np.isfinite(step) & moving, step, 0.0), -1.0), 1.0)
        x, y = x + step[0], y + step[1]
        moving = np.abs(step).max(axis=0) >= STEP_DONE_PX
        if not moving.any():
            break
    g, gx, gy = _model(stamps, x, y, inverse)
    wg = weight * g
    with np.errstate(invalid="ignore", divide="ignore"):
        peak = _dot(wg, stamps.value) / _dot(wg, g)
        information = peak**2 * 0.5 * (_dot(weight * gx, gx) + _dot(weight * gy, gy))
    return x, y, peak, information


def _dot(a: Array, b: Array) -> Array:
    return np.asarray(np.einsum("ij,ij->i", a, b))


def _model(stamps: Stamps, x: Array, y: Array, inverse: Array) -> tuple[Array, Array, Array]:
    """Return a Gaussian of unit peak on every stamp and its derivatives along x and y."""
    ax, ay = stamps.dx - x[:, None], stamps.dy - y[:, None]
    px, py = inverse[0, 0] * ax + inverse[0, 1] * ay, inverse[0, 1] * ax + inverse[1, 1] * ay
    g = np.exp(-0.5 * (px * ax + py * ay))
    return g, g * px, g * py


def subtract_neighbours(stamps: Stamps, fit: PsfFit, covariance: Array) -> tuple[Stamps, NDArray[np.bool_]]:
    """Subtract from each stamp the fitted models of other stars that reach into it.

    Returns the stamps and an (n,) mask of the stars with such neighbours.
    """
    half = float(stamps.dx.max())
    reach = half + 2.5 * widths_px(covariance)[1]
    first, second = close_pairs(fit.col, fit.row, reach)
    owner, neighbour = np.concatenate([first, second]), np.concatenate([second, first])
    owner, neighbour = owner[fit.good[neighbour]], neighbour[fit.good[neighbour]]
    if not len(owner):
        return stamps, np.zeros(len(stamps.col), bool)
    inverse = np.linalg.inv(covariance)
    ax = stamps.dx + (stamps.col[owner] - fit.col[neighbour])[:, None]
    ay = stamps.dy + (stamps.row[owner] - fit.row[neighbour])[:, None]
    g = np.exp(-0.5 * (inverse[0, 0] * ax * ax + 2 * inverse[0, 1] * ax * ay + inverse[1, 1] * ay * ay))
    peak = fit.flux[neighbour] / (2 * np.pi * np.sqrt(np.linalg.det(covariance)))
    value = stamps.value.copy()
    np.subtract.at(value, owner, g * peak[:, None])
    touched = np.zeros(len(stamps.col), bool)
    touched[owner] = True
    return Stamps(stamps.col, stamps.row, stamps.dx, stamps.dy, value, stamps.use), touched

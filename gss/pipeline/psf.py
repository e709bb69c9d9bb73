"""Star positions from least-squares fits of one Gaussian point-spread function to all stars of a frame.

All stars share the covariance of the function (pixel integration included). The shape is measured on bright stars and
used for faint stars, so the error of a faint star is close to the Cramér–Rao bound. For trailed stars, the covariance
is elongated.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.pipeline.small import close_pairs

FIT_ROUNDS = 6
MOMENT_ROUNDS = 14
STEP_DONE_PX = 2e-4
MODEL_FLOOR = 0.006  # position error, as a share of the width, because a real lens is not Gaussian

NARROWEST_PX = 0.05
NEIGHBOUR_SIGMA = 2.5  # a star within this distance of a stamp adds light to it
UNSATURATED_SHARE = 0.34  # of a stamp's pixels; stars with less are fitted with their saturated pixels


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
) -> PsfFit:
    """Fit position and flux of n stars by Gauss–Newton, each stamp separately.

    ``covariance``: (2, 2) px² of the point-spread function. ``noise``: (n,) standard deviation of a sky pixel.
    ``e_per_dn`` > 0 includes shot noise in the pixel weights.
    """
    inverse: Array = np.asarray(np.linalg.inv(covariance), float)
    x, y, peak, information = _fitted(stamps, start_col - stamps.col, start_row - stamps.row, inverse, noise, e_per_dn)
    area = float(np.sqrt(np.linalg.det(covariance)))
    with np.errstate(invalid="ignore", divide="ignore"):
        sigma = np.sqrt(1 / information + MODEL_FLOOR**2 * area)
    at_its_star = np.hypot(x, y) < reach_px(int(stamps.dx[-1]))
    good = np.isfinite(peak) & (peak > 0) & np.isfinite(sigma) & at_its_star
    return PsfFit(stamps.col + x, stamps.row + y, peak * 2 * np.pi * area, sigma, good)


def reach_px(half: int) -> float:
    """Return the largest distance of a fitted star from the middle of its stamp."""
    return max(2.0, 0.6 * half)


def _fitted(
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
    reach = half + NEIGHBOUR_SIGMA * widths_px(covariance)[1]
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


def second_moments(
    image: NDArray[Any], col: NDArray[np.intp], row: NDArray[np.intp], sky: Array, half: int, ceiling: float
) -> tuple[Array, Array, Array]:
    """Return the second moments xx, xy and yy of n stars in px², each (n,); not finite for stars without light."""
    stamps = cut_stamps(image, col, row, sky, half, ceiling)
    value = stamps.value * stamps.use
    dx, dy = stamps.dx, stamps.dy
    total, x, y, xx, yy, xy = np.array([np.ones_like(dx), dx, dy, dx * dx, dy * dy, dx * dy]) @ value.T
    with np.errstate(invalid="ignore", divide="ignore"):
        x, y = x / total, y / total
        return xx / total - x * x, xy / total - x * y, yy / total - y * y


class Measured(NamedTuple):
    """Fits of n stars, each (n,); see :class:`PsfFit`. ``area``: pixels above twice the noise; ``peak``: brightest pixel above
    the sky; ``touched``: True for stars with light of a neighbour, which was subtracted."""

    col: Array
    row: Array
    flux: Array
    sigma_px: Array
    good: NDArray[np.bool_]
    area: NDArray[np.int32]
    peak: Array
    touched: NDArray[np.bool_]


def brightest_dn(image: NDArray[Any], pixels: Array) -> Array:
    """Return the (n,) brightest values of the (rows, columns) image within one pixel of (n, 2) positions. In contrast to
    ``Measured.peak``, it includes saturated pixels and the sky."""
    near = np.arange(-1, 2)
    col = np.clip(np.rint(pixels[:, 0]).astype(np.intp)[:, None, None] + near, 0, image.shape[1] - 1)
    row = np.clip(np.rint(pixels[:, 1]).astype(np.intp)[:, None, None] + near[:, None], 0, image.shape[0] - 1)
    return np.asarray(image[row, col].max(axis=(1, 2)), float)


def measure_stars(
    image: NDArray[Any],
    col: NDArray[np.intp],
    row: NDArray[np.intp],
    sky: Array,
    noise: Array,
    covariance: Array,
    half: int,
    ceiling: float,
    e_per_dn: float,
) -> Measured:
    """Fit n stars in stamps of (2·half+1)² pixels. Stars with neighbours are fitted again after the neighbours are
    subtracted. ``ceiling``: see :func:`cut_stamps`; the other parameters: see :func:`fit_stars`."""
    stamps = _with_saturated_pixels(cut_stamps(image, col, row, sky, half, ceiling), image)
    fit = fit_stars(stamps, col.astype(float), row.astype(float), covariance, noise, e_per_dn)
    cleaned, touched = subtract_neighbours(stamps, fit, covariance)
    if touched.any():
        again = _rows(cleaned, touched)
        better = fit_stars(again, fit.col[touched], fit.row[touched], covariance, noise[touched], e_per_dn)
        for values, replacement in zip(vars(fit).values(), vars(better).values(), strict=True):
            values[touched] = replacement
    area = np.count_nonzero(stamps.value > 2 * noise[:, None], axis=1).astype(np.int32)
    peak = np.where(stamps.use, stamps.value, -np.inf).max(1, initial=0.0)
    return Measured(fit.col, fit.row, fit.flux, fit.sigma_px, fit.good, area, peak, touched)


def _rows(stamps: Stamps, chosen: NDArray[np.bool_]) -> Stamps:
    return Stamps(
        stamps.col[chosen], stamps.row[chosen], stamps.dx, stamps.dy, stamps.value[chosen], stamps.use[chosen]
    )


def _with_saturated_pixels(stamps: Stamps, image: NDArray[Any]) -> Stamps:
    """Include the saturated pixels of stars of which few pixels are unsaturated. Otherwise these stars could not be fitted."""
    mostly_saturated = stamps.use.mean(1) < UNSATURATED_SHARE
    if not mostly_saturated.any():
        return stamps
    use = stamps.use.copy()
    row, col = stamps.row[:, None] + stamps.dy, stamps.col[:, None] + stamps.dx
    inside = (row >= 0) & (row < image.shape[0]) & (col >= 0) & (col < image.shape[1])
    use[mostly_saturated] = inside[mostly_saturated]
    return Stamps(stamps.col, stamps.row, stamps.dx, stamps.dy, stamps.value, use)

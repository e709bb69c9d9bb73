"""Compiled loops that find candidate stars. Each is equivalent to the numpy function that its docstring names; a test
compares the results."""

# The loops have no type annotations: numba compiles them for the argument types.
# mypy: allow-untyped-defs

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.pipeline.background import Background
from gss.pipeline.loops import loop
from gss.pipeline.peaks import NARROWEST_PX2, SINGLE_DOUBT_SIGMA, SINGLE_SHARE
from gss.pipeline.small import Rows


def significant(
    smooth: NDArray[Any], background: Background, sigma: float, down: Array, across: Array
) -> tuple[Rows, Rows, Array]:
    """Return rows, columns and signal-to-noise ratios of the significant maxima; equivalent to ``peaks._significant``."""
    level, noise = background.level, background.noise
    lowest = np.empty(level.shape, smooth.dtype)
    limits = (0.0, float(np.iinfo(smooth.dtype).max)) if smooth.dtype.kind == "u" else (-math.inf, math.inf)
    _lowest_thresholds(level, noise, sigma, limits, lowest)
    top = np.empty((len(level), smooth.shape[1]), smooth.dtype)
    _brightest(smooth, background.tile_px, top)
    rows, cols = smooth.shape
    flat = np.empty((rows + 1) // 2 * ((cols + 1) // 2), np.intp)  # no more pixels can be maxima
    flat = flat[: _maxima(smooth, top, lowest, background.tile_px, flat)]
    snr = _ratios(smooth, level, noise, background.tile_px, down, across, flat)
    flat, snr = flat[snr > sigma], snr[snr > sigma]
    order = np.lexsort((flat, -snr))
    row, col = np.divmod(flat[order], smooth.shape[1])
    return row, col, snr[order]


@loop
def _lowest_thresholds(level, noise, sigma, limits, out):
    """Equivalent to ``Background.lowest_threshold``, converted to the type of the filtered frame, which has
    these ``limits``. An integer is rounded towards zero, so that a larger pixel exceeds the threshold."""
    rows, cols = level.shape
    for r in range(rows):
        for c in range(cols):
            lowest = math.inf
            for rr in range(max(r - 1, 0), min(r + 2, rows)):
                for cc in range(max(c - 1, 0), min(c + 2, cols)):
                    lowest = min(lowest, level[rr, cc] + sigma * noise[rr, cc])
            out[r, c] = min(max(lowest, limits[0]), limits[1])


@loop
def _brightest(smooth, tile, top):
    """Write the brightest pixel of each column of each row of tiles."""
    for k in range(len(top)):
        top[k] = smooth[k * tile]
        for r in range(k * tile + 1, min((k + 1) * tile, len(smooth))):
            for c in range(top.shape[1]):
                top[k, c] = max(top[k, c], smooth[r, c])


@loop
def _maxima(smooth, top, lowest, tile, flat):
    """Write the flat indices of the maxima, tile by tile, and return their number. Only columns with a pixel above the
    limit of the tile are examined."""
    cols, n = smooth.shape[1], 0
    chosen = np.empty(tile, np.intp)
    for k in range(lowest.shape[0]):
        for t in range(lowest.shape[1]):
            limit = lowest[k, t]
            if not _any_above(top[k, t * tile : (t + 1) * tile], limit):
                continue
            count = 0
            for c in range(t * tile, min((t + 1) * tile, cols)):
                if top[k, c] > limit:
                    chosen[count] = c
                    count += 1
            for r in range(k * tile, min((k + 1) * tile, len(smooth))):
                for i in range(count):
                    c = chosen[i]
                    if smooth[r, c] > limit and _is_maximum(smooth, r, c):
                        flat[n] = r * cols + c
                        n += 1
    return n


@loop
def _ratios(smooth, level, noise, tile, down, across, flat):
    """Return the signal-to-noise ratios of pixels of the filtered frame."""
    rows, cols = smooth.shape
    out = np.empty(len(flat))
    for i in range(len(flat)):
        r, c = flat[i] // cols, flat[i] % cols
        edge = down[min(r, rows - 1 - r, len(down) - 1)] * across[min(c, cols - 1 - c, len(across) - 1)]
        sky, spread = _at(level, noise, tile, c, r)
        out[i] = (smooth[r, c] - sky) / (spread * edge)
    return out


@loop
def _any_above(part, limit):
    any_above = False
    for value in part:  # no early exit, because it would prevent vectorisation
        any_above |= value > limit
    return any_above


@loop
def _at(level, noise, tile, col, row):
    """Equivalent to ``Background.at`` of one pixel."""
    rows, cols = level.shape
    r = min(max((row + 0.5) / tile - 0.5, 0.0), rows - 1.0)
    c = min(max((col + 0.5) / tile - 0.5, 0.0), cols - 1.0)
    a, b = int(r), int(c)
    below, right, down, across = min(a + 1, rows - 1), min(b + 1, cols - 1), r - int(r), c - int(c)
    value = (level[a, b] * (1 - across) + level[a, right] * across) * (1 - down)
    value += (level[below, b] * (1 - across) + level[below, right] * across) * down
    spread = (noise[a, b] * (1 - across) + noise[a, right] * across) * (1 - down)
    spread += (noise[below, b] * (1 - across) + noise[below, right] * across) * down
    return value, spread


@loop
def _is_maximum(smooth, r, c):
    rows, cols = smooth.shape
    value = smooth[r, c]
    for rr in range(max(r - 1, 0), min(r + 2, rows)):
        for cc in range(max(c - 1, 0), min(c + 2, cols)):
            other = smooth[rr, cc]
            if other > value or (other == value and (rr < r or (rr == r and cc < c))):
                return False
    return True


def sky_of(background: Background, col: Rows, row: Rows) -> tuple[Array, Array]:
    """Return sky level and noise at n pixels; equivalent to ``Background.at``."""
    sky, noise = np.empty(len(col)), np.empty(len(col))
    _sky_of(background.level, background.noise, background.tile_px, col, row, sky, noise)
    return sky, noise


@loop
def _sky_of(level, noise, tile, col, row, sky_out, noise_out):
    for i in range(len(col)):
        sky_out[i], noise_out[i] = _at(level, noise, tile, col[i], row[i])


def single_pixels(
    image: NDArray[Any], row: Rows, col: Rows, sky: Array, noise: Array, covariance: Array
) -> NDArray[np.bool_]:
    """Return whether n peaks are confined to one pixel, row or column; equivalent to ``peaks._is_single_pixel``."""
    out = np.empty(len(row), np.bool_)
    _single_pixels(image, row, col, sky, noise, covariance, out)
    return out


@loop
def _single_pixels(image, row, col, sky, noise, covariance, out):
    share_col = SINGLE_SHARE * 2 * math.exp(-0.5 / max(covariance[0, 0], NARROWEST_PX2))
    share_row = SINGLE_SHARE * 2 * math.exp(-0.5 / max(covariance[1, 1], NARROWEST_PX2))
    for i in range(len(row)):
        r, c = row[i], col[i]
        highest = _pixel(image, r - 1, c - 1)
        for k in range(9):
            value = _pixel(image, row[i] + k // 3 - 1, col[i] + k % 3 - 1)
            if k == 0 or value > highest:
                highest, r, c = value, row[i] + k // 3 - 1, col[i] + k % 3 - 1
        peak, doubt = _pixel(image, r, c) - sky[i], SINGLE_DOUBT_SIGMA * noise[i]
        across = _pixel(image, r, c - 1) + _pixel(image, r, c + 1) - 2 * sky[i]
        along = _pixel(image, r - 1, c) + _pixel(image, r + 1, c) - 2 * sky[i]
        out[i] = across + doubt < share_col * peak or along + doubt < share_row * peak


@loop
def _pixel(image, r, c):
    """Return the pixel nearest to (r, c) that is on the detector."""
    return float(image[min(max(r, 0), image.shape[0] - 1), min(max(c, 0), image.shape[1] - 1)])

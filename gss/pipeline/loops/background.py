"""Compiled loops of the sky background. Each is equivalent to the numpy function that its docstring names; a test
compares the results."""

# The loops have no type annotations: numba compiles them for the argument types.
# mypy: allow-untyped-defs

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.pipeline.background import CLIP_ROUNDS, CLIP_SIGMA, FLAT_PER_SIGMA, LEAST_NOISE, LEAST_SHARE
from gss.pipeline.loops import loop
from gss.pipeline.loops.small import middle_of
from gss.pipeline.small import Rows

# Compare-exchange steps of a sorting network that moves the median of nine values to index 4 (Smith 1996, 19 steps).
EXCHANGES = "12 45 78 01 34 67 12 45 78 03 58 47 36 14 25 47 42 64 42"
MEDIAN_OF_NINE = np.array([divmod(int(pair), 10) for pair in EXCHANGES.split()])


def tile_samples(image: NDArray[Any], tile: int, step: int) -> NDArray[Any]:
    """Return (tiles, samples) of every ``step``-th pixel; equivalent to ``background._tile_samples`` for an image of whole
    tiles."""
    per = tile // step
    out = np.empty((image.shape[0] // tile * (image.shape[1] // tile), per * per), image.dtype)
    _tile_samples(image, tile, step, out)
    return out


@loop
def _tile_samples(image, tile, step, out):
    across, per = image.shape[1] // tile, tile // step
    for r in range(image.shape[0] // step):
        line = image[step // 2 + r * step]
        for t in range(across):
            part = out[(r // per) * across + t, (r % per) * per : (r % per + 1) * per]
            for c in range(per):
                part[c] = line[step // 2 + t * tile + c * step]


def clip(ordered: NDArray[Any], count: Rows) -> tuple[Array, Array]:
    """Return clipped means and standard deviations of sorted rows; equivalent to ``background._clipped``."""
    mean, spread = np.empty(len(ordered)), np.empty(len(ordered))
    _clip(ordered, count, mean, spread)
    return mean, spread


@loop(fastmath={"reassoc"})
def _clip(ordered, count, mean_out, spread_out):
    off = np.empty(ordered.shape[1])
    for i in range(len(ordered)):
        n = count[i]
        middle = float(ordered[i, max(int(0.5 * (n - 1) + 0.5), 0)])
        low = float(ordered[i, max(int(0.1587 * (n - 1) + 0.5), 0)])
        high = float(ordered[i, max(int(0.8413 * (n - 1) + 0.5), 0)])
        total = squares = distance = 0.0
        for k in range(n):
            off[k] = ordered[i, k] - middle
            distance += abs(off[k])
            total += off[k]
            squares += off[k] * off[k]
        spread = max((high - low) / 2, min(distance / max(n, 1), 0.5))
        mean = 0.0
        for _ in range(CLIP_ROUNDS):
            reach = CLIP_SIGMA * spread + 1e-12
            first, last = 0, n
            while first < n and mean - off[first] > reach:
                first += 1
            while last > first and off[last - 1] - mean > reach:
                last -= 1
            kept, kept_squares = total, squares
            if last - first < n:  # subtracting large outliers from the sums would lose digits
                kept = kept_squares = 0.0
                for k in range(first, last):
                    kept += off[k]
                    kept_squares += off[k] * off[k]
            mean = kept / max(last - first, 1)
            spread = math.sqrt(max(kept_squares / max(last - first, 1) - mean * mean, 0.0)) * 1.014
        mean_out[i], spread_out[i] = middle + mean, spread


def smooth_mesh(level: Array, noise: Array) -> tuple[Array, Array]:
    """Return level and noise of the mesh without its outliers; equivalent to ``background._smooth_mesh``."""
    smooth_level, smooth_noise = _median_of_nine(level, MEDIAN_OF_NINE), _median_of_nine(noise, MEDIAN_OF_NINE)
    _flatten(smooth_level, smooth_noise)
    return smooth_level, smooth_noise


@loop
def _median_of_nine(mesh, exchanges):
    rows, cols = mesh.shape
    out = np.empty((rows, cols))
    nine = np.empty((9, cols))
    for r in range(rows):
        for k in range(9):
            line = mesh[min(max(r + k // 3 - 1, 0), rows - 1)]
            for c in range(cols):
                nine[k, c] = line[min(max(c + k % 3 - 1, 0), cols - 1)]
        for k in range(len(exchanges)):
            a, b = nine[exchanges[k, 0]], nine[exchanges[k, 1]]
            for c in range(cols):
                low, high = min(a[c], b[c]), max(a[c], b[c])
                a[c], b[c] = low, high
        out[r] = nine[4]
    return out


@loop
def _flatten(level, noise):
    """Set the levels to their mean if they agree within their error, and limit the noise from below."""
    typical = middle_of(noise.ravel(), noise.size)
    if np.std(level) < FLAT_PER_SIGMA * typical:
        level[:] = np.mean(level)
    lowest = max(LEAST_SHARE * typical, LEAST_NOISE)
    for r in range(noise.shape[0]):
        for c in range(noise.shape[1]):
            noise[r, c] = max(noise[r, c], lowest)


def residuals(image: NDArray[Any], level: Array, tile: int, step: int) -> Array:
    """Return the differences of every ``step``-th pixel from the mesh; equivalent to ``background._residuals``."""
    size = [len(range(step // 2, n, step)) for n in image.shape]
    out = np.empty((size[0], size[1]))
    _residuals(image, level, tile, step, out)
    return out.ravel()


@loop
def _residuals(image, level, tile, step, out):
    rows, cols = level.shape
    left, part = np.empty(out.shape[1], np.intp), np.empty(out.shape[1])
    for k in range(out.shape[1]):
        at = min(max((step // 2 + k * step + 0.5) / tile - 0.5, 0.0), cols - 1.0)
        left[k] = min(int(at), max(cols - 2, 0))
        part[k] = at - left[k]
    line = np.empty(cols)
    for i in range(out.shape[0]):
        r = step // 2 + i * step
        at = min(max((r + 0.5) / tile - 0.5, 0.0), rows - 1.0)
        top = min(int(at), max(rows - 2, 0))
        below, down = min(top + 1, rows - 1), at - top
        for c in range(cols):
            line[c] = level[top, c] * (1 - down) + level[below, c] * down
        for k in range(out.shape[1]):
            a = left[k]
            sky = line[a] * (1 - part[k]) + line[min(a + 1, cols - 1)] * part[k]
            out[i, k] = image[r, step // 2 + k * step] - sky

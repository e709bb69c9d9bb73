"""Inner loops of detection, compiled by numba. Each is equivalent to the numpy function that its docstring names; a
test compares the results."""

# The loops have no type annotations: numba compiles them for the argument types.
# mypy: allow-untyped-defs

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.pipeline.kernels import CLIP_ROUNDS, CLIP_SIGMA
from gss.pipeline.psf import FIT_ROUNDS, STEP_DONE_PX, Stamps

Rows = NDArray[np.intp]
BLOCK = 128


def binomial(image: NDArray[Any]) -> NDArray[Any]:
    """Apply the binomial filter; equivalent to ``peaks._binomial_sum``."""
    kind = np.uint16 if image.dtype == np.uint8 else np.float32
    out = np.empty(image.shape, kind)
    if kind is np.uint16:
        _binomial_integer(image, out)
    else:
        _binomial_float(np.ascontiguousarray(image, np.float32), out)
    return out


@njit(cache=True)
def _binomial_integer(image, out):
    rows, cols = image.shape
    line = np.empty(cols + 4, np.uint16)
    for r in range(rows):
        a, b = max(r - 2, 0), max(r - 1, 0)
        d, e = min(r + 1, rows - 1), min(r + 2, rows - 1)
        for c in range(cols):
            line[c + 2] = (
                np.uint16(image[a, c])
                + np.uint16(image[e, c])
                + np.uint16(4) * (np.uint16(image[b, c]) + np.uint16(image[d, c]))
                + np.uint16(6) * np.uint16(image[r, c])
            )
        line[0] = line[1] = line[2]
        line[cols + 2] = line[cols + 3] = line[cols + 1]
        for c in range(cols):
            out[r, c] = line[c] + line[c + 4] + np.uint16(4) * (line[c + 1] + line[c + 3]) + np.uint16(6) * line[c + 2]


@njit(cache=True)
def _binomial_float(image, out):
    """Add in the same order as the numpy version: pairs of neighbours, four times along rows, then four times along columns."""
    rows, cols = image.shape
    across = np.empty((rows, cols), np.float32)
    line = np.empty(cols + 4, np.float32)
    for r in range(rows):
        for c in range(cols):
            line[c + 2] = image[r, c]
        line[0] = line[1] = line[2]
        line[cols + 2] = line[cols + 3] = line[cols + 1]
        for k in range(3):
            for c in range(cols + 3 - k):
                line[c] = line[c] + line[c + 1]
        for c in range(cols):
            across[r, c] = line[c] + line[c + 1]
    for r in range(rows):
        a, b = max(r - 2, 0), max(r - 1, 0)
        d, e = min(r + 1, rows - 1), min(r + 2, rows - 1)
        for c in range(cols):
            v0, v1, v2, v3, v4 = across[a, c], across[b, c], across[r, c], across[d, c], across[e, c]
            w0, w1, w2, w3 = v0 + v1, v1 + v2, v2 + v3, v3 + v4
            x0, x1, x2 = w0 + w1, w1 + w2, w2 + w3
            out[r, c] = (x0 + x1) + (x1 + x2)


def clip(ordered: NDArray[Any], count: Rows) -> tuple[Array, Array]:
    """Return clipped means and standard deviations of sorted rows; equivalent to ``background._clipped``."""
    mean, spread = np.empty(len(ordered)), np.empty(len(ordered))
    _clip(ordered, count, mean, spread)
    return mean, spread


@njit(cache=True, fastmath={"reassoc"})
def _clip(ordered, count, mean_out, spread_out):
    off = np.empty(ordered.shape[1])
    for i in range(len(ordered)):
        n = count[i]
        middle = float(ordered[i, max(int(0.5 * (n - 1) + 0.5), 0)])
        low = float(ordered[i, max(int(0.1587 * (n - 1) + 0.5), 0)])
        high = float(ordered[i, max(int(0.8413 * (n - 1) + 0.5), 0)])
        total = 0.0
        for k in range(n):
            off[k] = ordered[i, k] - middle
            total += abs(off[k])
        spread = max((high - low) / 2, min(total / max(n, 1), 0.5))
        mean = 0.0
        for _ in range(CLIP_ROUNDS):
            reach = CLIP_SIGMA * spread + 1e-12
            first, last = 0, n
            while first < n and mean - off[first] > reach:
                first += 1
            while last > first and off[last - 1] - mean > reach:
                last -= 1
            total, in_range = 0.0, max(last - first, 1)
            for k in range(first, last):
                total += off[k]
            mean = total / in_range
            total = 0.0
            for k in range(first, last):
                total += (off[k] - mean) ** 2
            spread = math.sqrt(total / in_range) * 1.014
        mean_out[i], spread_out[i] = middle + mean, spread


def maxima(smooth: NDArray[Any], lowest: NDArray[Any], tile: int) -> tuple[Rows, Rows]:
    """Return rows and columns of the local maxima above their limit; equivalent to ``peaks._maxima``. ``lowest``: limits
    (tile rows, columns), of the frame's dtype. ``tile``: rows per tile."""
    flat = _maxima(np.ascontiguousarray(smooth), np.ascontiguousarray(lowest), tile)
    return np.divmod(flat, smooth.shape[1])


@njit(cache=True)
def _maxima(smooth, lowest, tile):
    rows, cols = smooth.shape
    blocks = -(-cols // BLOCK)
    hit = np.empty((rows, blocks), np.bool_)
    for r in range(rows):
        line, limits = smooth[r], lowest[r // tile]
        for k in range(blocks):
            part, limit = line[k * BLOCK : (k + 1) * BLOCK], limits[k * BLOCK : (k + 1) * BLOCK]
            any_above = False
            for c in range(len(part)):  # no early exit, because it would prevent vectorisation
                any_above |= part[c] > limit[c]
            hit[r, k] = any_above
    return _maxima_of(smooth, lowest, tile, hit)


@njit(cache=True)
def _maxima_of(smooth, lowest, tile, hit):
    """Return the flat indices of the maxima in blocks with a hit. A separate function, so that the loops above are vectorised."""
    rows, cols = smooth.shape
    out = np.empty(BLOCK * int(hit.sum()), np.intp)
    n = 0
    for r in range(rows):
        for k in range(hit.shape[1]):
            if hit[r, k]:
                for c in range(k * BLOCK, min((k + 1) * BLOCK, cols)):
                    if smooth[r, c] > lowest[r // tile, c] and _is_maximum(smooth, r, c):
                        out[n] = r * cols + c
                        n += 1
    return out[:n].copy()


@njit(cache=True)
def _is_maximum(smooth, r, c):
    rows, cols = smooth.shape
    value = smooth[r, c]
    for rr in range(max(r - 1, 0), min(r + 2, rows)):
        for cc in range(max(c - 1, 0), min(c + 2, cols)):
            other = smooth[rr, cc]
            if other > value or (other == value and (rr < r or (rr == r and cc < c))):
                return False
    return True


def fit(
    stamps: Stamps, x: Array, y: Array, inverse: Array, noise: Array, e_per_dn: float
) -> tuple[Array, Array, Array, Array]:
    """Return converged star offsets, peaks and information; equivalent to ``psf.fitted``."""
    x, y = np.array(x, float), np.array(y, float)
    peak, information = np.empty(len(x)), np.empty(len(x))
    side = int(stamps.dx[-1]) * 2 + 1
    _fit(side, stamps.value, stamps.use, noise, float(e_per_dn), inverse, x, y, peak, information)
    return x, y, peak, information


@njit(cache=True, error_model="numpy", fastmath={"reassoc"})
def _fit(side, value, use, noise, e_per_dn, inverse, x, y, peak, information):
    k = side * side
    weight, g, gx, gy = np.empty(k), np.empty(k), np.empty(k), np.empty(k)
    for i in range(len(x)):
        for j in range(k):
            variance = noise[i] ** 2
            if e_per_dn > 0:
                variance += max(value[i, j], 0.0) / e_per_dn
            weight[j] = 1 / variance if use[i, j] else 0.0
        for _ in range(FIT_ROUNDS):
            _gaussian(side, x[i], y[i], inverse, g, gx, gy)
            gg = gv = hxx = hyy = hxy = 0.0
            for j in range(k):
                w = weight[j]
                gg += w * g[j] * g[j]
                gv += w * g[j] * value[i, j]
                hxx += w * gx[j] * gx[j]
                hyy += w * gy[j] * gy[j]
                hxy += w * gx[j] * gy[j]
            top = gv / gg
            bx = by = 0.0
            for j in range(k):
                residual = weight[j] * (value[i, j] - top * g[j])
                bx += residual * gx[j]
                by += residual * gy[j]
            det = (hxx * hyy - hxy * hxy) * top
            sx, sy = (hyy * bx - hxy * by) / det, (hxx * by - hxy * bx) / det
            sx = min(max(sx, -1.0), 1.0) if math.isfinite(sx) else 0.0
            sy = min(max(sy, -1.0), 1.0) if math.isfinite(sy) else 0.0
            x[i] += sx
            y[i] += sy
            if max(abs(sx), abs(sy)) < STEP_DONE_PX:
                break
        _gaussian(side, x[i], y[i], inverse, g, gx, gy)
        gg = gv = slopes = 0.0
        for j in range(k):
            w = weight[j]
            gg += w * g[j] * g[j]
            gv += w * g[j] * value[i, j]
            slopes += w * (gx[j] * gx[j] + gy[j] * gy[j])
        peak[i] = gv / gg
        information[i] = peak[i] ** 2 * 0.5 * slopes


@njit(cache=True)
def _gaussian(side, x, y, inverse, g, gx, gy):
    """Write a Gaussian of unit peak and its derivatives. Without correlation of the axes, it is a product of two
    lines, which needs 2·side exponentials instead of side²."""
    xx, xy, yy = inverse[0, 0], inverse[0, 1], inverse[1, 1]
    half = side // 2
    across = np.empty(side)
    for c in range(side):
        across[c] = math.exp(-0.5 * xx * (c - half - x) ** 2)
    for r in range(side):
        ay = r - half - y
        down = math.exp(-0.5 * yy * ay * ay)
        for c in range(side):
            j, ax = r * side + c, c - half - x
            g[j] = across[c] * down
            if xy != 0.0:
                g[j] *= math.exp(-xy * ax * ay)
            gx[j], gy[j] = g[j] * (xx * ax + xy * ay), g[j] * (xy * ax + yy * ay)


def lit(image: NDArray[Any], threshold: float) -> Rows:
    """Return the flat indices of the pixels above a threshold, ascending."""
    if image.dtype.kind == "u":
        limit = math.floor(threshold)
        top = int(np.iinfo(image.dtype).max)
        if limit >= top:
            return np.empty(0, np.intp)
        if limit < 0:
            return np.arange(image.size)
        limit_value = np.full(1, limit, image.dtype)
        rows: Rows = _lit(np.ascontiguousarray(image).ravel(), limit_value[0])
        return rows
    return np.flatnonzero(image > threshold)


@njit(cache=True)
def _lit(flat, limit):
    size = len(flat)
    out = np.empty(1024, np.intp)
    n = 0
    for first in range(0, size, 2 * BLOCK):
        last = min(first + 2 * BLOCK, size)
        any_above = False
        for value in flat[first:last]:
            any_above |= value > limit
        if not any_above:
            continue
        for c in range(first, last):
            if flat[c] > limit:
                if n == len(out):
                    larger = np.empty(2 * n, np.intp)
                    larger[:n] = out
                    out = larger
                out[n] = c
                n += 1
    return out[:n]


def components(lit: Rows, columns: int) -> tuple[int, NDArray[np.int32]]:
    """Label the 4-connected components of lit pixels, numbered by their first pixel; equivalent to ``regions._label``."""
    label = np.empty(len(lit), np.int32)
    return int(_components(lit, columns, label)), label


@njit(cache=True)
def _components(lit, columns, label):
    n = len(lit)
    parent = np.arange(n)
    up = 0
    for i in range(n):
        if i > 0 and lit[i] - lit[i - 1] == 1 and lit[i] % columns != 0:
            _join(parent, i, i - 1)
        while up < i and lit[up] < lit[i] - columns:
            up += 1
        if up < i and lit[up] == lit[i] - columns:
            _join(parent, i, up)
    count = 0
    for i in range(n):
        root = _root(parent, i)
        if root == i:
            label[i] = count
            count += 1
        else:
            label[i] = label[root]
    return count


@njit(cache=True)
def _root(parent, i):
    while parent[i] != i:
        parent[i] = parent[parent[i]]
        i = parent[i]
    return i


@njit(cache=True)
def _join(parent, i, j):
    """Merge two components. The earlier root stays, because components are numbered by their first pixel."""
    a, b = _root(parent, i), _root(parent, j)
    if a < b:
        parent[b] = a
    else:
        parent[a] = b

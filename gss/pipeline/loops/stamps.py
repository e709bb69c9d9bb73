"""Compiled loops that measure stars in small windows. Each is equivalent to the numpy function that its docstring names;
a test compares the results."""

# The loops have no type annotations: numba compiles them for the argument types.
# mypy: allow-untyped-defs

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.pipeline.detect import BRIGHT_SNR, BRIGHTEST
from gss.pipeline.loops import loop
from gss.pipeline.loops.small import middle_of
from gss.pipeline.peaks import Peaks
from gss.pipeline.psf import (
    FIT_ROUNDS,
    MODEL_FLOOR,
    NARROWEST_PX,
    NEIGHBOUR_SIGMA,
    STEP_DONE_PX,
    UNSATURATED_SHARE,
    reach_px,
    widths_px,
)
from gss.pipeline.small import Rows

UNDERFLOW = 600  # exp(-600) is still a normal number


def sizes(image: NDArray[Any], peaks: Peaks, covariance: Array, ceiling: float) -> tuple[float, float]:
    """Return the two sizes of the bright stars in px²; equivalent to ``detect._sizes``."""
    half = math.ceil(4 * math.sqrt(covariance[0, 0]))
    moments = np.empty((3, BRIGHTEST))
    usual, large = _sizes(
        image, peaks.col, peaks.row, peaks.sky, peaks.snr, peaks.single, half, float(ceiling), moments
    )
    return float(usual), float(large)


@loop
def _sizes(image, col, row, sky, snr, single, half, ceiling, moments):
    n = 0
    for i in range(len(col)):
        if n < BRIGHTEST and not single[i] and snr[i] > BRIGHT_SNR:
            _second_moments(image, col[i], row[i], sky[i], half, ceiling, moments[:, n])
            n += 1
    if n < 3 or not np.isfinite(moments[:, :n]).all():
        return 0.0, 0.0
    xx, xy, yy = middle_of(moments[0], n), middle_of(moments[1], n), middle_of(moments[2], n)
    longest = max((xx + yy) / 2 + math.hypot((xx - yy) / 2, xy), NARROWEST_PX**2)
    ordered = np.sort((moments[0, :n] + moments[2, :n]) / 2)
    position = 0.75 * (n - 1)
    k = int(position)
    return longest, ordered[k] + (position - k) * (ordered[min(k + 1, n - 1)] - ordered[k])


@loop
def _second_moments(image, col, row, sky, half, ceiling, out):
    """Equivalent to ``psf.second_moments`` of one star."""
    total = x = y = xx = yy = xy = 0.0
    for r in range(max(row - half, 0), min(row + half + 1, image.shape[0])):
        for c in range(max(col - half, 0), min(col + half + 1, image.shape[1])):
            raw = float(image[r, c])
            if raw < ceiling:
                value, dx, dy = raw - sky, c - col, r - row
                total += value
                x += value * dx
                y += value * dy
                xx += value * dx * dx
                yy += value * dy * dy
                xy += value * dx * dy
    x, y = x / total, y / total
    out[0], out[1], out[2] = xx / total - x * x, xy / total - x * y, yy / total - y * y


def measure(
    image: NDArray[Any],
    col: Rows,
    row: Rows,
    sky: Array,
    noise: Array,
    covariance: Array,
    half: int,
    ceiling: float,
    e_per_dn: float,
) -> tuple[Array, Array, Array, Array, NDArray[np.bool_], NDArray[np.int32], Array, NDArray[np.bool_]]:
    """Measure n stars. Returns col, row, flux, sigma, good, area, peak, touched; equivalent to ``psf.measure_stars``."""
    n, side = len(col), 2 * half + 1
    value, use = np.empty((n, side * side)), np.empty((n, side * side), np.bool_)
    area, peak, touched = np.empty(n, np.int32), np.empty(n), np.zeros(n, np.bool_)
    x, y, top, sigma, good = np.zeros(n), np.zeros(n), np.empty(n), np.empty(n), np.empty(n, np.bool_)
    xx, xy, yy = float(covariance[0, 0]), float(covariance[0, 1]), float(covariance[1, 1])
    det = xx * yy - xy * xy
    inverse = np.array([[yy, -xy], [-xy, xx]]) / det
    _cut(image, col, row, sky, noise, half, float(ceiling), value, use, area, peak)
    fits = (x, y, top, sigma, good)
    _fit(side, value, use, noise, e_per_dn, inverse, reach_px(half), math.sqrt(det), np.ones(n, np.bool_), *fits)
    reach = half + NEIGHBOUR_SIGMA * widths_px(covariance)[1]
    _subtract_neighbours(side, value, col, row, x, y, top, good, inverse, reach, touched)
    _fit(side, value, use, noise, e_per_dn, inverse, reach_px(half), math.sqrt(det), touched, *fits)
    return col + x, row + y, top * (2 * math.pi * math.sqrt(det)), sigma, good, area, peak, touched


@loop
def _cut(image, col, row, sky, noise, half, ceiling, value, use, area, peak):
    rows, cols = image.shape
    for i in range(len(col)):
        usable, bright, j = 0, 0, 0
        for r in range(row[i] - half, row[i] + half + 1):
            line = image[min(max(r, 0), rows - 1)]
            for c in range(col[i] - half, col[i] + half + 1):
                raw = float(line[min(max(c, 0), cols - 1)])
                value[i, j], use[i, j] = raw - sky[i], raw < ceiling and 0 <= r < rows and 0 <= c < cols
                usable += use[i, j]
                bright += raw - sky[i] > 2 * noise[i]
                j += 1
        if usable < UNSATURATED_SHARE * j:
            j = 0
            for r in range(row[i] - half, row[i] + half + 1):
                for c in range(col[i] - half, col[i] + half + 1):
                    use[i, j] = 0 <= r < rows and 0 <= c < cols
                    j += 1
        highest = 0.0
        for k in range(j):
            if use[i, k]:
                highest = max(highest, value[i, k])
        area[i], peak[i] = bright, highest


@loop
def _fit(side, value, use, noise, e_per_dn, inverse, reach, width2, chosen, x, y, peak, sigma, good):
    """Fit the ``chosen`` stars; equivalent to ``psf.fit_stars``. ``x`` and ``y`` are first guesses and become the results.
    ``width2``: root of the determinant of the covariance."""
    xx, xy, yy = inverse[0, 0], inverse[0, 1], inverse[1, 1]
    dn_per_e = 1 / e_per_dn if e_per_dn > 0 else 0.0
    weight, light, across, down = np.empty(side * side), np.empty(side * side), np.empty(side), np.empty(side)
    for i in range(len(x)):
        if not chosen[i]:
            continue
        _weigh(value[i], use[i], noise[i] ** 2, dn_per_e, weight, light)
        for _ in range(FIT_ROUNDS):
            g, gc, gr, gcc, gcr, grr, v, vc, vr = _moments(side, x[i], y[i], inverse, weight, light, across, down)
            top = v / g
            bc, br = vc - top * gc, vr - top * gr
            bx, by = xx * bc + xy * br, xy * bc + yy * br
            hxx = xx * xx * gcc + 2 * xx * xy * gcr + xy * xy * grr
            hxy = xx * xy * gcc + (xx * yy + xy * xy) * gcr + xy * yy * grr
            hyy = xy * xy * gcc + 2 * xy * yy * gcr + yy * yy * grr
            det = (hxx * hyy - hxy * hxy) * top
            sx, sy = (hyy * bx - hxy * by) / det, (hxx * by - hxy * bx) / det
            sx = min(max(sx, -1.0), 1.0) if math.isfinite(sx) else 0.0
            sy = min(max(sy, -1.0), 1.0) if math.isfinite(sy) else 0.0
            x[i] += sx
            y[i] += sy
            if max(abs(sx), abs(sy)) < STEP_DONE_PX:
                break
        g, _, _, gcc, gcr, grr, v, _, _ = _moments(side, x[i], y[i], inverse, weight, light, across, down)
        slopes = (xx * xx + xy * xy) * gcc + 2 * xy * (xx + yy) * gcr + (xy * xy + yy * yy) * grr
        peak[i] = v / g
        sigma[i] = math.sqrt(1 / (peak[i] ** 2 * 0.5 * slopes) + MODEL_FLOOR**2 * width2)
        at_its_star = math.hypot(x[i], y[i]) < reach
        good[i] = math.isfinite(peak[i]) and peak[i] > 0 and math.isfinite(sigma[i]) and at_its_star


@loop
def _weigh(value, use, noise2, dn_per_e, weight, light):
    """Write the inverse variance of each pixel, and its product with the pixel."""
    for j in range(len(value)):
        variance = noise2 + (value[j] if value[j] > 0 else 0.0) * dn_per_e
        weight[j] = (1.0 if use[j] else 0.0) / variance
        light[j] = weight[j] * value[j]


@loop
def _bell(inverse, centre, out):
    """Write a Gaussian line of unit peak. The ratio of two neighbours changes by a constant factor, so that three
    exponentials are enough, except for a line so narrow that its first pixel is 0."""
    first = 0.5 * inverse * centre * centre
    if first > UNDERFLOW:
        for k in range(len(out)):
            out[k] = math.exp(-0.5 * inverse * (k - centre) ** 2)
        return
    value, ratio, factor = math.exp(-first), math.exp(inverse * (centre - 0.5)), math.exp(-inverse)
    for k in range(len(out)):
        out[k] = value
        value *= ratio
        ratio *= factor


@loop(fastmath={"reassoc"})
def _moments(side, x, y, inverse, weight, light, across, down):
    """Return the weighted moments of a Gaussian of unit peak about its centre: of its square, to the second order in
    columns (c) and rows (r), and of its product with the pixels, to the first order. All sums of the fit are
    combinations of these. ``light``: weight times pixel value."""
    xx, xy, yy = inverse[0, 0], inverse[0, 1], inverse[1, 1]
    half = side // 2
    _bell(yy - xy * xy / xx, half + y, down)
    g = gc = gr = gcc = gcr = grr = v = vc = vr = 0.0
    for r in range(side):
        ay = r - half - y
        if r == 0 or xy != 0.0:
            _bell(xx, half + x - xy / xx * ay, across)  # the maximum of the row
        p = pc = pcc = q = qc = 0.0
        for c in range(side):
            ax, model = c - half - x, across[c] * down[r]
            square, product = weight[r * side + c] * model * model, light[r * side + c] * model
            p += square
            pc += square * ax
            pcc += square * ax * ax
            q += product
            qc += product * ax
        g += p
        gc += pc
        gcc += pcc
        gr += p * ay
        gcr += pc * ay
        grr += p * ay * ay
        v += q
        vc += qc
        vr += q * ay
    return g, gc, gr, gcc, gcr, grr, v, vc, vr


@loop
def _subtract_neighbours(side, value, col, row, x, y, top, good, inverse, reach, touched):
    """Equivalent to ``psf.subtract_neighbours``."""
    half = side // 2
    order = np.argsort(col + x)
    for a in range(len(order)):
        i = order[a]
        for b in range(a + 1, len(order)):
            j = order[b]
            if not (col[j] + x[j]) - (col[i] + x[i]) <= reach:
                break
            if abs((row[j] + y[j]) - (row[i] + y[i])) <= reach:
                for owner, other in ((i, j), (j, i)):
                    if good[other]:
                        touched[owner] = True
                        dx, dy = col[other] - col[owner] + x[other], row[other] - row[owner] + y[other]
                        for q in range(side * side):
                            ax, ay = q % side - half - dx, q // side - half - dy
                            power = inverse[0, 0] * ax * ax + 2 * inverse[0, 1] * ax * ay + inverse[1, 1] * ay * ay
                            value[owner, q] -= top[other] * math.exp(-0.5 * power)


def separate(image: NDArray[Any], col: Rows, row: Rows, snr: Array, sky: Array, width: float) -> Rows:
    """Return the indices of the separate stars; equivalent to ``detect._separate_stars``."""
    drop = np.zeros(len(col), np.bool_)
    _separate(image, col, row, snr, sky, max(3.0, 2.2 * width), np.argsort(col, kind="stable"), drop)
    return np.flatnonzero(~drop)


@loop
def _separate(image, col, row, snr, sky, reach, order, drop):
    place = np.empty(len(order), np.intp)
    for k in range(len(order)):
        place[order[k]] = k
    for i in range(len(col)):
        if drop[i]:
            continue
        for step in (-1, 1):
            k = place[i] + step
            while 0 <= k < len(order) and abs(col[order[k]] - col[i]) <= 3 * reach:
                j = order[k]
                if j > i and not drop[j] and abs(row[j] - row[i]) <= 3 * reach:
                    drop[j] = _belongs(image, col[i], row[i], snr[i], col[j], row[j], snr[j], sky[j], reach)
                k += step


@loop
def _belongs(image, col, row, snr, other_col, other_row, other_snr, sky, reach):
    """Return whether the second peak is a part of the first star."""
    distance, ratio = math.hypot(col - other_col, row - other_row), other_snr / snr
    if distance > 3 * reach:
        return False
    if distance < reach * 0.8 or (distance < reach and ratio < 0.5) or ratio < 0.02:
        return True
    if distance < 2 * reach and ratio < 0.05:
        return True
    parts = int(distance) + 1
    lowest = math.inf
    for k in range(1, parts):
        t = k * (1.0 / parts)
        value = float(image[int(np.rint(row + t * (other_row - row))), int(np.rint(col + t * (other_col - col)))])
        lowest = min(lowest, value)
    return lowest - sky > 0.8 * (float(image[other_row, other_col]) - sky)

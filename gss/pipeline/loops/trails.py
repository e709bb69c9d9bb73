"""Compiled sums of the fit of trails; equivalent to ``streaks.fit_sums``."""

# The loops have no type annotations: numba compiles them for the argument types.
# mypy: allow-untyped-defs

from __future__ import annotations

import math

import numpy as np

from gss.domain.angles import Array
from gss.pipeline.loops import loop
from gss.pipeline.streaks import LEAST_FLUX, FitSums, Trails
from gss.pipeline.trail_shape import LEAST_PX, UNDIRECTED_PX

REACH = 5.5
"""Number of standard deviations from a trail beyond which its light is neglected: 3e-7 of the peak."""
PEAK = 1 / math.sqrt(2 * math.pi)
"""Maximum of the normal distribution."""


def sums(trails: Trails, turned: Array, width2: float, x: Array, y: Array, variance: Array, e_per_dn: float) -> FitSums:
    """Return the sums of a step. Arguments as in ``streaks.fit_sums``."""
    n, k = trails.value.shape
    model, expected = np.zeros((n, k)), np.empty((n, k))
    products, pulls = np.empty((n, 7, 7)), np.empty((n, 7))
    pixels = (trails.value, trails.use, trails.dx, trails.dy, np.ascontiguousarray(variance))
    trail = np.ascontiguousarray(trails.per_rad @ turned)
    stars = (x, y, trail, trails.per_rad, trails.sky_variance)
    chi2 = _sums(*pixels, *stars, float(width2), float(e_per_dn), model, expected, products, pulls)
    return FitSums(model, float(chi2), expected, products, pulls)


@loop
def _sums(
    value, use, dx, dy, variance, x, y, trail, per_rad, sky_variance, width2, e_per_dn, model, expected, products, pulls
):
    chi2, jacobian = 0.0, np.zeros((7, 6))
    shapes, place = np.empty((6, len(dx))), np.empty(len(dx), np.intp)
    weight, light = np.empty(len(dx)), np.empty(len(dx))
    jacobian[0, 0] = 1.0
    for i in range(len(x)):
        near, total = _shapes(dx, dy, x[i], y[i], trail[i], width2, shapes, place), 0.0
        for m in range(near):
            j = place[m]
            weight[m] = (1.0 if use[i, j] else 0.0) / variance[i, j]
            light[m] = weight[m] * value[i, j]
        square, pull = _products(near, shapes, weight, light)
        for j in range(len(dx)):
            total += abs(value[i, j])
        flux = max(pull[0] / max(square[0, 0], 1e-300), LEAST_FLUX * total)
        jacobian[1, 1] = jacobian[2, 2] = -flux
        jacobian[6, 5] = flux
        for axis in range(3):
            jacobian[3 + axis, 3] = flux * per_rad[i, 0, axis]
            jacobian[3 + axis, 4] = flux * per_rad[i, 1, axis]
        products[i] = jacobian @ square @ jacobian.T
        pulls[i] = jacobian @ (pull - flux * square[0])
        for m in range(near):
            model[i, place[m]] = flux * shapes[0, m]
        for j in range(len(dx)):
            more = max(model[i, j], 0.0) / e_per_dn if e_per_dn > 0 else 0.0
            expected[i, j] = sky_variance[i] + more
            if use[i, j]:
                chi2 += (value[i, j] - model[i, j]) ** 2 / variance[i, j]
    return chi2


@loop(fastmath={"reassoc", "contract"})
def _products(near, shapes, weight, light):
    """Return the (6, 6) weighted sums of the products of the shapes, and their (6,) products with the weighted pixels."""
    square, pull = np.empty((6, 6)), np.empty(6)
    for p in range(6):
        first, part = shapes[p], 0.0
        for m in range(near):
            part += first[m] * light[m]
        pull[p] = part
        for q in range(p, 6):
            second, part = shapes[q], 0.0
            for m in range(near):
                part += weight[m] * first[m] * second[m]
            square[p, q] = square[q, p] = part
    return square, pull


@loop
def _share_below(x, bell):
    """Return the normal distribution at ``x`` with an error below 1e-7 (Abramowitz and Stegun, 26.2.17). ``bell``: exp(-x²/2),
    which the caller needs too."""
    t = 1.0 / (1.0 + 0.2316419 * abs(x))
    tail = t * (0.319381530 + t * (-0.356563782 + t * (1.781477937 + t * (-1.821255978 + t * 1.330274429))))
    above = bell * PEAK * tail
    return 1.0 - above if x > 0 else above


@loop
def _shapes(dx, dy, x, y, trail, width2, shapes, place):
    """Write the (6, k) shape of a trail of unit flux and its derivatives with respect to x, y, the two components of the trail,
    and the variance, and the places of the k pixels near the trail. Return k. Equivalent to
    ``trail_shape.trailed_gaussian``."""
    sigma, length = math.sqrt(width2), math.hypot(trail[0], trail[1])
    long, ex, ey = max(length, LEAST_PX), 1.0, 0.0
    if length > UNDIRECTED_PX:
        ex, ey = trail[0] / length, trail[1] / length
    narrow, short, inverse = 1 / sigma, 1 / long, 1 / width2
    near = 0
    for j in range(len(dx)):
        ax, ay = dx[j] - x, dy[j] - y
        a, b = ax * ex + ay * ey, ay * ex - ax * ey
        if abs(b) > REACH * sigma or abs(a) > long / 2 + REACH * sigma:
            continue
        high, low = (a + long / 2) * narrow, (a - long / 2) * narrow
        bell_high, bell_low = math.exp(-0.5 * high * high), math.exp(-0.5 * low * low)
        phi_high, phi_low = bell_high * PEAK, bell_low * PEAK
        between = _share_below(high, bell_high) - _share_below(low, bell_low)
        across = math.exp(-0.5 * b * b * inverse) * narrow * PEAK * short
        shape = across * between
        by_a, by_b = across * (phi_high - phi_low) * narrow, -b * inverse * shape
        by_length = across * (0.5 * (phi_high + phi_low) * narrow - between * short)
        by_turn = (by_a * b - by_b * a) * short
        ends = across * (phi_high * high - phi_low * low)
        place[near], shapes[0, near] = j, shape
        shapes[1, near], shapes[2, near] = ex * by_a - ey * by_b, ey * by_a + ex * by_b
        shapes[3, near] = ex * by_length - ey * by_turn
        shapes[4, near] = ey * by_length + ex * by_turn
        shapes[5, near] = (shape * (b * b * inverse - 1) - ends) * 0.5 * inverse
        near += 1
    return near

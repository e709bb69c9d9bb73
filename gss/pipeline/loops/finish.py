"""Compiled steps after the verification: fit, identification of the remaining detections, and fit to all matches."""

# The loops have no type annotations: numba compiles them for the argument types.
# mypy: allow-untyped-defs

from __future__ import annotations

import math

import numpy as np

from gss.pipeline.identify.faint import (
    BRIGHTNESS_SIGMA,
    FIT_FLOOR_PX,
    FLOOR_PX,
    MAX_EXCESS_PX,
    MIN_MATCHES,
    ROUNDS,
)
from gss.pipeline.loops import loop
from gss.pipeline.loops.fit import fit_attitude
from gss.pipeline.loops.naming import (
    aberrated,
    assign,
    excess_px,
    expected_stars,
    flux_line,
    line_mag,
)
from gss.pipeline.loops.small import middle_of


@loop
def _fitted(camera, spots, sigma_px, extra2, icrs, velocity, rows, stars, count, turn):
    """Fit the attitude to the first ``count`` matches; return residuals, weights, covariance and rms."""
    pixels, unit, sigma = np.empty((count, 2)), np.empty((count, 3)), np.empty(count)
    for k in range(count):
        pixels[k] = spots[rows[k]]
        unit[k, 0], unit[k, 1], unit[k, 2] = aberrated(icrs, stars[k], velocity)
        sigma[k] = math.sqrt(sigma_px[rows[k]] ** 2 + extra2[k])
    residual, weight, covariance = np.empty((count, 2)), np.empty(count), np.empty((3, 3))
    rms = fit_attitude(camera, pixels, unit, sigma, turn, residual, weight, covariance)
    return residual, weight, covariance, rms


@loop
def _line(magnitude, magnitude_sigma, v_mag, rows, stars, count):
    """Return the line from instrumental to catalogue magnitude through the first ``count`` matches."""
    m, v, s = np.empty(count), np.empty(count), np.empty(count)
    for k in range(count):
        m[k], v[k], s[k] = magnitude[rows[k]], v_mag[stars[k]], magnitude_sigma[rows[k]]
    return flux_line(m, v, s)


@loop
def finish(camera, spots, error_px, centroid, magnitude, psf_px, sky, velocity, rows, bright_stars, deep_row, turn):
    """Fit the attitude to the verified matches ``rows`` and ``bright_stars``, then to all detections that can be
    identified. If the second fit fails, return the first. Equivalent to ``faint.match_all``.

    ``error_px``: position errors of all centroids; ``centroid``: the centroid of each of the ``spots``; ``deep_row``: row in
    ``sky`` of each star of the identification; ``turn``: initial attitude, replaced by the fitted attitude. Returns rows,
    stars, residuals, weights, covariance and rms.
    """
    icrs, v_mag, cells = sky
    n, count = len(spots), len(rows)
    sigma_px, magnitude_sigma = np.empty(n), np.empty(n)
    for k in range(n):
        sigma_px[k] = max(error_px[centroid[k]], FIT_FLOOR_PX)
        magnitude_sigma[k] = 1.0857 * min(sigma_px[k] / psf_px, 0.5)
    stars, verified = np.empty(count, np.int64), np.full(n, -1, np.int64)
    for k in range(count):
        stars[k] = deep_row[bright_stars[k]]
        verified[rows[k]] = stars[k]
    no_extra = np.zeros(count)
    residual, weight, covariance, rms = _fitted(
        camera, spots, sigma_px, no_extra, icrs, velocity, rows, stars, count, turn
    )
    first = (rows.copy(), stars, residual, weight, covariance, rms)
    first_turn = turn.copy()
    named_rows, named_stars = first[0], first[1]
    name, moved2 = np.empty(n, np.int64), np.empty(n)
    for _ in range(ROUNDS):
        line = _line(magnitude, magnitude_sigma, v_mag, named_rows, named_stars, len(named_rows))
        faintest = -math.inf
        for k in range(n):
            v, sigma_v = line_mag(line, magnitude[k])
            faintest = max(faintest, v + BRIGHTNESS_SIGMA * sigma_v)
        star, places = expected_stars(camera, icrs, v_mag, cells, velocity, turn, faintest + 1.0)
        excess = excess_px(residual, weight, sigma_px, named_rows, len(named_rows))
        assign(
            spots,
            sigma_px,
            magnitude,
            magnitude_sigma,
            psf_px,
            star,
            places,
            line,
            max(excess, FLOOR_PX),
            verified,
            sky,
            (camera, velocity, turn, covariance),
            name,
            moved2,
        )
        matched = 0
        for k in range(n):
            matched += name[k] >= 0
        if matched < max(MIN_MATCHES, count // 2):
            turn[:] = first_turn
            return first
        new_rows, new_stars, extra2 = np.empty(matched, np.int64), np.empty(matched, np.int64), np.empty(matched)
        m, moved, settled = 0, False, matched == len(named_rows)
        for k in range(n):
            e = name[k]
            if e >= 0:
                new_rows[m], new_stars[m] = k, star[e]
                moved |= moved2[k] > 0
                extra2[m] = moved2[k] + excess * excess
                settled = settled and named_rows[m] == k and named_stars[m] == star[e]
                m += 1
        if settled and excess == 0.0 and not moved:
            break  # the current fit already uses these stars and errors
        named_rows, named_stars = new_rows, new_stars
        residual, weight, covariance, rms = _fitted(
            camera, spots, sigma_px, extra2, icrs, velocity, named_rows, named_stars, matched, turn
        )
        if settled:
            break
    if rms > math.sqrt(MAX_EXCESS_PX**2 + middle_of(sigma_px, n) ** 2):
        turn[:] = first_turn
        return first
    return named_rows, named_stars, residual, weight, covariance, rms

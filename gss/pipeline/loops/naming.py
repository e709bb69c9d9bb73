"""Compiled identification of the remaining detections; equivalent to ``identify.faint`` with a fixed camera."""

# The loops have no type annotations: numba compiles them for the argument types.
# mypy: allow-untyped-defs

from __future__ import annotations

import math

import numpy as np

from gss.pipeline.identify.faint import (
    BLEND_REACH_SIGMA,
    BRIGHTNESS_SIGMA,
    COMPARABLE,
    CROWDED,
    ERROR_MARGIN,
    GATE_SIGMA,
    MAX_CHANCE,
    MAX_GATE_PX,
    MEDIAN_SQUARE,
    MIN_FOR_EXCESS,
    OWN_SHARE,
    RESOLVED,
    UNRESOLVED_SIGMA,
    VERIFIED_WINDOW_MAG,
)
from gss.pipeline.identify.flux_line import (
    MIN_SCATTER_MAG,
    SCATTER_MAG,
    SCATTER_STARS,
    SETTLED_MAG,
    SLOPE_SIGMA,
)
from gss.pipeline.identify.flux_line import ROUNDS as LINE_ROUNDS
from gss.pipeline.loops import loop
from gss.pipeline.loops.cells import room_near, stars_near
from gss.pipeline.loops.fit import slopes, turned
from gss.pipeline.loops.geometry import COLUMNS, REACH, ROWS, contains, project
from gss.pipeline.loops.small import ascending, middle_of


@loop
def flux_line(magnitude, v_mag, sigma):
    """Return level, slope, middle, level_sigma, slope_sigma and scatter; equivalent to ``flux_line.flux_line``."""
    n = len(magnitude)
    middle = middle_of(magnitude, n)
    away, photons2 = magnitude - middle, sigma * sigma
    level, slope, scatter = middle_of(v_mag - away, n), 1.0, SCATTER_MAG
    typical2, prior = middle_of(photons2, n), SLOPE_SIGMA**-2
    total_weight = lever = determinant = 1.0
    for _ in range(LINE_ROUNDS):
        total_weight, cross, lever, level_sum, slope_sum = 0.0, 0.0, prior, 0.0, (1 - slope) * prior
        for k in range(n):
            residual = v_mag[k] - level - slope * away[k]
            weight = 1 / (scatter * scatter + photons2[k] + residual * residual / 4)
            pull = weight * away[k]
            total_weight += weight
            cross += pull
            lever += pull * away[k]
            level_sum += weight * residual
            slope_sum += pull * residual
        determinant = total_weight * lever - cross * cross
        up, steeper = (
            (lever * level_sum - cross * slope_sum) / determinant,
            (total_weight * slope_sum - cross * level_sum) / determinant,
        )
        level, slope, before = level + up, slope + steeper, scatter
        observed2 = (1.4826 * middle_of(np.abs(v_mag - level - slope * away), n)) ** 2 - typical2
        mixed = (n * max(observed2, 0.0) + SCATTER_STARS * SCATTER_MAG**2) / (n + SCATTER_STARS)
        scatter = max(math.sqrt(mixed), MIN_SCATTER_MAG)
        if max(abs(up), abs(steeper), abs(scatter - before)) < SETTLED_MAG:
            break
    return level, slope, middle, math.sqrt(lever / determinant), math.sqrt(total_weight / determinant), scatter


@loop
def line_mag(line, magnitude):
    """Return the catalogue magnitude for an instrumental magnitude, and its standard deviation."""
    away = magnitude - line[2]
    drift = line[4] * away
    return line[0] + line[1] * away, math.sqrt(line[5] * line[5] + line[3] * line[3] + drift * drift)


@loop
def aberrated(icrs, row, velocity):
    """Return a star's apparent direction (x, y, z) for an observer's velocity in units of c. Equivalent to
    ``aberration.aberrate``."""
    x, y, z = icrs[row, 0], icrs[row, 1], icrs[row, 2]
    u, v, w = velocity[0], velocity[1], velocity[2]
    beta2 = u * u + v * v + w * w
    if beta2 == 0.0:
        return x, y, z
    inverse_gamma = math.sqrt(1 - beta2)
    along = x * u + y * v + z * w
    factor, scale = 1 + along / (1 + inverse_gamma), 1 + along
    return (
        (inverse_gamma * x + factor * u) / scale,
        (inverse_gamma * y + factor * v) / scale,
        (inverse_gamma * z + factor * w) / scale,
    )


@loop
def expected_stars(camera, icrs, v_mag, cells, velocity, turn, faintest):
    """Return the rows and the (n, 2) pixels of the stars on the detector down to magnitude ``faintest``, sorted by column."""
    below = np.searchsorted(v_mag, min(faintest, v_mag[-1]), side="right")
    room = room_near(cells, turn[2], camera[REACH])
    star, places = np.empty(room, np.int64), np.empty((room, 2))
    near = stars_near(icrs, cells, turn[2], camera[REACH], below, star)
    count = 0
    for k in range(near):
        row = star[k]
        ax, ay, az = aberrated(icrs, row, velocity)
        x, y, z = turned(turn, ax, ay, az)
        col, line = project(camera, x, y, z)
        if contains(camera, col, line, MAX_GATE_PX):
            star[count], places[count, 0], places[count, 1] = row, col, line
            count += 1
    order = ascending(places[:count, 0])
    sorted_star, sorted_places = np.empty(count, np.int64), np.empty((count, 2))
    for k in range(count):
        row = order[k]
        sorted_star[k], sorted_places[k, 0], sorted_places[k, 1] = star[row], places[row, 0], places[row, 1]
    return sorted_star, sorted_places


@loop
def place_variance_px2(fit, icrs, row):
    """Return the variance per axis of a star's predicted position from the errors of the fitted attitude. ``fit``: camera,
    velocity, attitude and covariance."""
    camera, velocity, turn, covariance = fit
    ax, ay, az = aberrated(icrs, row, velocity)
    x, y, z = turned(turn, ax, ay, az)
    _, _, a, b, c, d, e, f = slopes(camera, x, y, z)
    xx, xy, xz = covariance[0, 0], covariance[0, 1], covariance[0, 2]
    yy, yz, zz = covariance[1, 1], covariance[1, 2], covariance[2, 2]
    variance = a * a * xx + b * b * yy + c * c * zz + 2 * (a * b * xy + a * c * xz + b * c * yz)
    variance += d * d * xx + e * e * yy + f * f * zz + 2 * (d * e * xy + d * f * xz + e * f * yz)
    return max(variance, 0.0) / 2


@loop
def appearance(a, star, v_mag, places, psf_px):
    """Return how star ``a`` of the expected stars appears: magnitude including companions, displacement by companions in column and
    row, the star's share of the light, and the largest distance of its detection. ``places``: sorted by column."""
    light, moved_col, moved_row, reach = 1.0, 0.0, 0.0, MAX_GATE_PX  # in units of the star's light
    widest = BLEND_REACH_SIGMA * psf_px
    for side in (-1, 1):
        b = a + side
        while 0 <= b < len(star) and abs(places[b, 0] - places[a, 0]) <= widest:
            across, down = places[b, 0] - places[a, 0], places[b, 1] - places[a, 1]
            d2 = across * across + down * down
            if d2 <= widest * widest:
                ratio = 10 ** (-0.4 * (v_mag[star[b]] - v_mag[star[a]]))
                # Light that a second Gaussian adds to the matched filter of the first Gaussian. This light also shifts
                # the fitted centre.
                overlap = ratio * math.exp(-d2 / (4 * psf_px * psf_px))
                light += overlap
                moved_col += overlap * across
                moved_row += overlap * down
                if ratio > COMPARABLE:
                    apart = math.sqrt(d2)
                    reach = min(reach, RESOLVED * apart if apart > UNRESOLVED_SIGMA * psf_px else 0.0)
            b += side
    bright = v_mag[star[a]]
    if light > 1.0:
        bright -= 2.5 * math.log10(light)
    return bright, moved_col / light, moved_row / light, 1 / light, reach


@loop
def assign(
    spots, sigma_px, magnitude, magnitude_sigma, psf_px, star, places, line, extra_px, verified, sky, fit, name, moved2
):
    """Write the expected star of each spot to ``name``, -1 if no star is unambiguous, and the square of the star's
    displacement by companions to ``moved2``. Equivalent to ``faint._assign``. ``star``, ``places``: see
    :func:`expected_stars`; ``fit``: see :func:`place_variance_px2`."""
    icrs, v_mag, _ = sky
    camera = fit[0]
    n = len(spots)
    count, columns, ranked = len(star), places[:, 0].copy(), v_mag[star]
    ranked = ranked[ascending(ranked)]
    rivals_of_star = np.zeros(count, np.int64)
    capacity = 64
    pair_spot, pair_star, pair_expected_stars, pair_moved2, pairs = (
        np.empty(capacity, np.int64),
        np.empty(capacity, np.int64),
        np.empty(capacity),
        np.empty(capacity),
        0,
    )
    rivals_of_spot, fitting_spots = np.zeros(n, np.int64), 0
    for s in range(n):
        v, sigma_v = line_mag(line, magnitude[s])
        noise = math.sqrt(sigma_v * sigma_v + magnitude_sigma[s] * magnitude_sigma[s])
        first = np.searchsorted(columns, spots[s, 0] - MAX_GATE_PX)
        for e in range(first, count):
            if columns[e] > spots[s, 0] + MAX_GATE_PX:
                break
            across, down = spots[s, 0] - places[e, 0], spots[s, 1] - places[e, 1]
            d2 = across * across + down * down
            if d2 > MAX_GATE_PX * MAX_GATE_PX:
                continue
            bright, shift_col, shift_row, share, reach = appearance(e, star, v_mag, places, psf_px)
            if d2 > reach * reach:
                continue
            shift2 = shift_col * shift_col + shift_row * shift_row
            variance = sigma_px[s] * sigma_px[s] + shift2 / 4 + extra_px * extra_px
            variance += place_variance_px2(fit, icrs, star[e])
            gate = min(GATE_SIGMA * math.sqrt(variance), MAX_GATE_PX)
            if (across - shift_col) ** 2 + (down - shift_row) ** 2 > gate * gate:
                continue
            difference, window = abs(v - bright), BRIGHTNESS_SIGMA * noise
            if difference > window:
                if verified[s] != star[e] or difference > VERIFIED_WINDOW_MAG:
                    continue
                window = VERIFIED_WINDOW_MAG
            if share < OWN_SHARE:
                continue
            among = np.searchsorted(ranked, bright + window, side="right") - np.searchsorted(ranked, bright - window)
            expected_stars = min(among * math.pi * gate * gate / (camera[COLUMNS] * camera[ROWS]), 1.0)
            if pairs == capacity:
                capacity *= 2
                pair_spot, pair_star, pair_expected_stars, pair_moved2 = (
                    np.concatenate((pair_spot, pair_spot)),
                    np.concatenate((pair_star, pair_star)),
                    np.concatenate((pair_expected_stars, pair_expected_stars)),
                    np.concatenate((pair_moved2, pair_moved2)),
                )
            pair_spot[pairs], pair_star[pairs] = s, e
            pair_expected_stars[pairs], pair_moved2[pairs] = expected_stars, shift2
            pairs += 1
            fitting_spots += rivals_of_spot[s] == 0
            rivals_of_spot[s] += 1
            rivals_of_star[e] += 1
    typical = middle_of(pair_expected_stars, pairs) if pairs else 0.0
    false_share = min(1.0, (n - fitting_spots + 1) / (n + 1) / max(1 - typical, 0.1))
    name[:] = -1
    for k in range(pairs):
        s, e = pair_spot[k], pair_star[k]
        chance = false_share * pair_expected_stars[k] if pair_expected_stars[k] <= CROWDED else 1.0
        if rivals_of_spot[s] == 1 and rivals_of_star[e] == 1 and chance <= MAX_CHANCE:
            name[s], moved2[s] = e, pair_moved2[k]


@loop
def excess_px(residual, weight, sigma_px, rows, count):
    """Return the scatter that the errors do not explain; equivalent to ``faint._excess_px``."""
    squares, error2, good = np.empty(count), np.empty(count), 0
    for k in range(count):
        if weight[k] > 0:
            squares[good] = residual[k, 0] ** 2 + residual[k, 1] ** 2
            error2[good] = sigma_px[rows[k]] ** 2
            good += 1
    if good < MIN_FOR_EXCESS:
        return 0.0
    return math.sqrt(max(middle_of(squares, good) / MEDIAN_SQUARE - ERROR_MARGIN * middle_of(error2, good), 0.0))

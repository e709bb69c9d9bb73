"""Compiled verification of a hypothesis; equivalent to ``identify.verify`` and ``identify.false_match``."""

# The loops have no type annotations: numba compiles them for the argument types.
# mypy: allow-untyped-defs

from __future__ import annotations

import math

import numpy as np

from gss.pipeline.identify.false_match import LEVELS, SMALLEST
from gss.pipeline.identify.verify import FULL_SHARE, MAX_RADIUS_PX, MIN_RADIUS_PX, RADIUS_SIGMA, ROUNDS
from gss.pipeline.loops import loop
from gss.pipeline.loops.cells import stars_near
from gss.pipeline.loops.geometry import COLUMNS, PIXEL_RAD, REACH, ROWS, best_rotation, contains, inverse, project
from gss.pipeline.loops.pairing import pair_up
from gss.pipeline.loops.small import middle_of

GAMMA_TERMS = 2000


@loop
def rotation_of(unit, sigma_rad, icrs, rows, stars, count, turn):
    """Write to ``turn`` the rotation that best maps the stars to their measured directions, weighted by 1/σ²."""
    profile = np.zeros((3, 3))
    for k in range(count):
        r, s = rows[k], stars[k]
        weight = 1 / sigma_rad[r] ** 2
        for i in range(3):
            for j in range(3):
                profile[i, j] += weight * unit[r, i] * icrs[s, j]
    best_rotation(profile, turn)


@loop
def _gamma_below(a, x):
    """Return the regularised lower incomplete gamma function."""
    if x <= 0:
        return 0.0
    if x > 2 * a + 60:
        return 1.0
    term = total = 1 / a
    for k in range(1, GAMMA_TERMS):
        term *= x / (a + k)
        total += term
        if term < 1e-17 * total:
            break
    return min(1.0, total * math.exp(a * math.log(x) - x - math.lgamma(a)))


@loop
def brightness_tail(magnitude, v_mag, rows, stars, count, spread):
    """Return the brightness tail; equivalent to ``false_match.brightness_tail``."""
    if count < 2 or not spread > 0:
        return 1.0
    mean = 0.0
    for k in range(count):
        mean += magnitude[rows[k]] - v_mag[stars[k]]
    mean /= count
    total = 0.0
    for k in range(count):
        total += (magnitude[rows[k]] - v_mag[stars[k]] - mean) ** 2
    return max(_gamma_below((count - 1) / 2, total / spread**2 / 2), SMALLEST)


@loop
def match_tail(at_least, trials, chance, brightness):
    """Return the tail of coincidences and brightness; equivalent to ``false_match.match_tail``."""
    met = max(at_least, 0)
    if met > trials:
        return 1.0
    lowest = max(met, 1)
    window = min(trials, met + LEVELS) - lowest + 1
    tail = np.zeros(trials - lowest + 2)
    if chance >= 1:
        tail[:] = 1.0
    elif chance > 0:
        log_term = (
            math.lgamma(trials + 1.0)
            - math.lgamma(lowest + 1.0)
            - math.lgamma(trials - lowest + 1.0)
            + lowest * math.log(chance)
            + (trials - lowest) * math.log1p(-chance)
        )
        # The first term can be below the smallest number. Terms are relative to it, and its logarithm is added at the
        # end.
        last, term, odds = lowest, 1.0, chance / (1 - chance)
        tail[0] = 1.0
        for k in range(lowest, trials):
            term *= (trials - k) / (k + 1.0) * odds
            if term < 1e-40:
                break
            last = k + 1
            tail[last - lowest] = term
        for k in range(last - 1, lowest - 1, -1):
            tail[k - lowest] += tail[k - lowest + 1]
        first = math.exp(max(log_term, -700.0))
        for k in range(last - lowest + 1):
            tail[k] = min(tail[k] * first, 1.0)
    start = 1.0 if met == 0 else tail[0]
    product = max(start * brightness, SMALLEST)
    above = 1 if met == 0 and product < 1.0 else 0
    for k in range(window):
        if tail[k] > product:
            above += 1
    tails = window + (1 if met == 0 else 0)
    levels = met + (trials - met if above == tails else above)
    return min(1.0, product * (1 + levels))


@loop
def _chance_of_offsets(offset, count, radius, predicted, camera, trials, brightness):
    area, least, next_least = 0.0, math.inf, math.inf
    for p in range(predicted):
        square = radius[p] * radius[p]
        area += square
        if square < least:
            least, next_least = square, least
        elif square < next_least:
            next_least = square
    area = math.pi * (area - least - next_least)
    best = 1.0
    for part in (1.0, 0.5):
        met = 0
        for k in range(count):
            if offset[k] <= part:
                met += 1
        chance = min(1.0, part**2 * area / (camera[COLUMNS] * camera[ROWS]))
        best = min(best, match_tail(met - 2, trials - 2, chance, brightness))
    return min(1.0, best * 2)


@loop
def _radii(camera, unit, sigma_rad, rows, used, cam, predicted, typical_px, radius):
    """Write the acceptance radius of each star; equivalent to ``verify._radius`` without calibration error."""
    information, covariance = np.zeros((3, 3)), np.empty((3, 3))
    total = 0.0
    for k in range(used):
        r = rows[k]
        weight = 1 / sigma_rad[r] ** 2
        total += weight
        for i in range(3):
            for j in range(3):
                information[i, j] -= weight * unit[r, i] * unit[r, j]
    for i in range(3):
        information[i, i] += total * (1 + 2e-12)
    inverse(information, covariance)
    trace = covariance[0, 0] + covariance[1, 1] + covariance[2, 2]
    for p in range(predicted):
        along = 0.0
        for i in range(3):
            for j in range(3):
                along += cam[p, i] * covariance[i, j] * cam[p, j]
        lever2 = max(trace - along, 0.0) * 0.75 / camera[PIXEL_RAD] ** 2
        reach = RADIUS_SIGMA * math.sqrt(typical_px * typical_px + lever2)
        radius[p] = min(max(reach, MIN_RADIUS_PX), MAX_RADIUS_PX)


@loop
def prepared(field):
    """Return the arrays of ``FrameDetections`` as :func:`verify` expects them: with the median position error, the standard
    deviation of the magnitudes, the order of the detections by column, and their columns in this order."""
    pixels, unit, sigma_rad, magnitude, sigma_px = field
    column = pixels[:, 0].copy()
    order = np.argsort(column)
    return (
        pixels,
        unit,
        sigma_rad,
        magnitude,
        middle_of(sigma_px, len(sigma_px)),
        np.std(magnitude),
        order,
        column[order],
    )


@loop
def verify(view, sky, camera, work, rows, stars, count, hypotheses, turn):
    """Verify a hypothesis; equivalent to ``verify.verify``. Replaces the first ``count`` ``rows`` and ``stars`` by all
    matches and writes the rotation. Returns the numbers of matches and of predicted stars, and the false-match
    probability; no matches if the hypothesis is inconsistent."""
    pixels, unit, sigma_rad, magnitude, typical_px, magnitude_spread, order, column = view
    icrs, v_mag, cells = sky
    visible, places, cam, radius, first_places, first_radius, to, back = work
    n = len(pixels)
    first_predicted = predicted = np.int64(0)
    first_seen = np.empty(0, np.int64)
    for round_ in range(ROUNDS):
        rotation_of(unit, sigma_rad, icrs, rows, stars, count, turn)
        near = stars_near(icrs, cells, turn[2], camera[REACH], len(icrs), visible)
        predicted = np.int64(0)
        for k in range(near):
            s = visible[k]
            x = turn[0, 0] * icrs[s, 0] + turn[0, 1] * icrs[s, 1] + turn[0, 2] * icrs[s, 2]
            y = turn[1, 0] * icrs[s, 0] + turn[1, 1] * icrs[s, 1] + turn[1, 2] * icrs[s, 2]
            z = turn[2, 0] * icrs[s, 0] + turn[2, 1] * icrs[s, 1] + turn[2, 2] * icrs[s, 2]
            col, row = project(camera, x, y, z)
            if contains(camera, col, row, 0.0):
                visible[predicted] = s
                places[predicted, 0], places[predicted, 1] = col, row
                cam[predicted, 0], cam[predicted, 1], cam[predicted, 2] = x, y, z
                predicted += 1
        if predicted < 2:
            return 0, predicted, 1.0
        _radii(camera, unit, sigma_rad, rows, count, cam, predicted, typical_px, radius)
        if round_ == 0:
            first_predicted = predicted
            first_places[:predicted] = places[:predicted]
            first_radius[:predicted] = radius[:predicted]
            first_seen = visible[:predicted].copy()
        pair_up(places, radius, predicted, pixels, order, column, to, back)
        matched, same = 0, 0
        for p in range(predicted):
            if to[p] >= 0:
                matched += 1
                for k in range(count):
                    if rows[k] == to[p] and stars[k] == visible[p]:
                        same += 1
                        break
        if matched < 3:
            return 0, predicted, 1.0
        settled = matched == count and same == count
        count = np.int64(0)
        for m in range(n):  # in the order of the detections
            p = back[m]
            if p >= 0 and to[p] == m:
                rows[count], stars[count] = m, visible[p]
                count += 1
        if settled:
            break  # another round would give the same matches
    mean = squares = 0.0
    for p in range(predicted):
        mean += v_mag[visible[p]]
    mean /= predicted
    for p in range(predicted):
        squares += (v_mag[visible[p]] - mean) ** 2
    spread = math.sqrt(squares / predicted + magnitude_spread * magnitude_spread)
    brightness = brightness_tail(magnitude, v_mag, rows, stars, count, spread)
    offset = np.full(count, math.inf)
    for k in range(count):
        for p in range(first_predicted):
            if first_seen[p] == stars[k]:
                across, down = first_places[p, 0] - pixels[rows[k], 0], first_places[p, 1] - pixels[rows[k], 1]
                offset[k] = math.sqrt(across * across + down * down) / first_radius[p]
                break
    tail = _chance_of_offsets(offset, count, first_radius, first_predicted, camera, n, brightness)
    return count, predicted, min(1.0, max(hypotheses, 1.0) * tail)


@loop
def without_one(view, sky, camera, work, first, rows, stars, count, predicted, chance, hypotheses, turn):
    """Verify again without each of the ``first`` three detections; equivalent to ``verify.without_one``. Replace the match
    by one with more stars. Return its number of stars and of predicted stars."""
    n = len(view[0])
    if count >= FULL_SHARE * min(n, predicted):
        return count, predicted
    some_rows, some_stars, other_turn = np.empty(n, np.int64), np.empty(n, np.int64), np.empty((3, 3))
    matched_rows, matched_stars = rows[:count].copy(), stars[:count].copy()
    for left_out in first:
        others = np.int64(0)
        for m in range(len(matched_rows)):
            if matched_rows[m] != left_out:
                some_rows[others], some_stars[others] = matched_rows[m], matched_stars[m]
                others += 1
        if others < 3:
            continue
        more, more_predicted, its_chance = verify(
            view, sky, camera, work, some_rows, some_stars, others, hypotheses, other_turn
        )
        if more > count and its_chance <= chance:
            count, predicted = more, more_predicted
            rows[:more], stars[:more] = some_rows[:more], some_stars[:more]
            turn[:] = other_turn
    return count, predicted


@loop
def workspace(stars, detections_):
    """Return buffers for :func:`verify`."""
    return (
        np.empty(stars, np.int64),
        np.empty((stars, 2)),
        np.empty((stars, 3)),
        np.empty(stars),
        np.empty((stars, 2)),
        np.empty(stars),
        np.empty(stars, np.int64),
        np.empty(detections_, np.int64),
    )

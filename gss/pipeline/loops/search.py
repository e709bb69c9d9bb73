"""Compiled pair search for identification without a prior attitude; equivalent to ``pair_search.PairSearch`` and
``pyramid.identify_lost``."""

# The loops have no type annotations: numba compiles them for the argument types.
# mypy: allow-untyped-defs

from __future__ import annotations

import math

import numpy as np

from gss.pipeline.loops import loop
from gss.pipeline.loops.proof import verify, workspace

EXHAUSTED, TOO_LONG = 0, -1
WORD = 32  # bits of a word of the marks


@loop
def geometry(unit, sigma_rad, sigmas, scale_error):
    """Return distance and tolerance of each pair of (n, 3) directions, and middle and half width of the range of its cosine."""
    n = len(unit)
    distance, tolerance = np.zeros((n, n)), np.zeros((n, n))
    middle, half = np.zeros((n, n)), np.zeros((n, n))
    for i in range(n):
        for k in range(i, n):
            x, y, z = unit[i, 0] - unit[k, 0], unit[i, 1] - unit[k, 1], unit[i, 2] - unit[k, 2]
            d = 2 * math.asin(min(1.0, math.sqrt(x * x + y * y + z * z) / 2))
            t = sigmas * math.sqrt(sigma_rad[i] ** 2 + sigma_rad[k] ** 2) + scale_error * d
            near, far = math.cos(max(d - t, 0.0)), math.cos(d + t)
            distance[i, k] = distance[k, i] = d
            tolerance[i, k] = tolerance[k, i] = t
            middle[i, k] = middle[k, i] = (far + near) / 2
            half[i, k] = half[k, i] = (near - far) / 2
    return distance, tolerance, middle, half


@loop
def _mark(i, start, stop, first, second, mark):
    """Set bit k of ``mark`` (stars, words + 1) for each catalogue star that can be star i according to its pair with
    star k. The last column counts these pairs."""
    mark[:] = 0
    count, one = mark.shape[1] - 1, np.uint32(1)
    for k in range(len(start)):
        if k == i:
            continue
        word, bit = k // WORD, one << np.uint32(k % WORD)
        for p in range(start[k], stop[k]):
            for s in (first[p], second[p]):
                mark[s, word] |= bit
                mark[s, count] += one


@loop
def _first_pair(pairs, low, high, row):
    """Return the index between ``low`` and ``high`` of the first of the ascending ``pairs`` that is not below ``row``."""
    while low < high:
        middle = (low + high) // 2
        if pairs[middle] < row:
            low = middle + 1
        else:
            high = middle
    return low


@loop
def _join(i, j, table, start, stop, mark_i, mark_j, icrs, handedness, flat, middle, half, need, out):
    """Write the best supported hypotheses of the pair (i, j) to ``out``: rows (star of i, star of j, third, star of the
    third, votes). Return their number."""
    first, second, offsets, pairs = table
    words, one = mark_i.shape[1] - 1, np.uint32(1)
    count = 0
    for side in range(2):
        for p in range(start[j], stop[j]):
            a, b = (first[p], second[p]) if side == 0 else (second[p], first[p])
            common = 0
            for word in range(words):
                bits = mark_i[a, word] & mark_j[b, word]
                while bits:
                    bits &= bits - one
                    common += 1
            if common < need:
                continue
            bx, by, bz = icrs[b, 0], icrs[b, 1], icrs[b, 2]
            ax, ay, az = icrs[a, 0], icrs[a, 1], icrs[a, 2]
            nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
            votes, third, its, widest = 0, -1, -1, -1.0
            k = -1
            while common > 0 and votes + common >= need:
                k += 1
                if not (mark_i[a, k // WORD] & mark_j[b, k // WORD]) >> np.uint32(k % WORD) & one:
                    continue
                common -= 1
                wide, star = abs(handedness[k]), -1
                q = _first_pair(pairs, offsets[a], offsets[a + 1], start[k])
                while q < offsets[a + 1] and pairs[q] < stop[k]:
                    c = first[pairs[q]] + second[pairs[q]] - a
                    q += 1
                    off = -middle[j, k] + bx * icrs[c, 0] + by * icrs[c, 1] + bz * icrs[c, 2]
                    if abs(off) > half[j, k] or c == b:
                        continue
                    triple = nx * icrs[c, 0] + ny * icrs[c, 1] + nz * icrs[c, 2]
                    # Nearly collinear triangles have no reliable handedness; they are tested later on the whole field.
                    if handedness[k] * triple > 0 or max(wide, abs(triple)) < flat[k]:
                        star = c if star < 0 else min(star, c)
                if star >= 0:
                    votes += 1
                    if wide > widest:
                        widest, third, its = wide, k, star
            if votes < need or (count == len(out) and votes <= out[count - 1, 4]):
                continue
            slot = count if count < len(out) else count - 1
            count = min(count + 1, len(out))
            while slot > 0 and out[slot - 1, 4] < votes:
                out[slot] = out[slot - 1]
                slot -= 1
            out[slot, 0], out[slot, 1], out[slot, 2], out[slot, 3], out[slot, 4] = a, b, third, its, votes
    return count


@loop
def next_pair(unit, icrs, table, geometry_of, ranges, marks, state, limits, out):
    """Examine pairs in order from ``state`` until one has candidates. Return their number, EXHAUSTED or TOO_LONG.

    ``table``: first and second stars of the pairs, and their neighbours (``DistanceTable.by_star``). ``ranges``: first
    and last + 1 row of the table of each pair of detections. ``marks``: see :func:`_mark`, and True if they are set.
    ``state``: sum of the rows of the next pair, its first row, number of hypotheses, joined rows. ``limits``: rows per
    pair, rows of one join, rows in total, COLLINEAR, minimum number of supporting detections, groups.
    """
    distance, tolerance, middle, half = geometry_of
    start, stop = ranges
    first, second = table[:2]
    mark, marked = marks
    n = len(unit)
    handedness, flat = np.empty(n), np.empty(n)
    while state[0] < 2 * n - 2:
        total, i = state[0], state[1]
        if i >= (total + 1) // 2:
            state[0] = total + 1
            state[1] = max(0, total + 1 - n + 1)
            continue
        j = total - i
        if state[3] > limits[2]:
            return TOO_LONG
        state[1] = i + 1
        if (j - i) % limits[5] or stop[i, j] <= start[i, j]:
            continue
        state[2] += 2 * (stop[i, j] - start[i, j])
        for k in (i, j):
            if not marked[k]:
                _mark(k, start[k], stop[k], first, second, mark[k])
                marked[k] = True
        rows = 0
        for p in range(start[i, j], stop[i, j]):
            rows += int(mark[i, first[p], -1]) + int(mark[i, second[p], -1])
        state[3] += rows + limits[0]
        if rows > limits[1]:
            continue  # too unspecific to be evidence
        cx = unit[i, 1] * unit[j, 2] - unit[i, 2] * unit[j, 1]
        cy = unit[i, 2] * unit[j, 0] - unit[i, 0] * unit[j, 2]
        cz = unit[i, 0] * unit[j, 1] - unit[i, 1] * unit[j, 0]
        for k in range(n):
            handedness[k] = unit[k, 0] * cx + unit[k, 1] * cy + unit[k, 2] * cz
            flat[k] = limits[3] * tolerance[i, j] * max(distance[i, j], distance[i, k], distance[j, k])
        count = _join(
            i, j, table, start[i], stop[i], mark[i], mark[j], icrs, handedness, flat, middle, half, limits[4], out
        )
        if count:
            return count
    return EXHAUSTED


@loop
def find(
    view, sky, table, camera, brightest, scale_error, sigmas, limits, need, groups, accept, least, rows, stars, turn
):
    """Examine pairs of the ``brightest`` detections, verify their hypotheses, and stop at the first whose false-match
    probability is at most ``accept``. Write its matches and rotation.

    Returns the number of matches, predicted stars, false-match probability, hypotheses, and True if the budget was used
    up. If no candidate is accepted, the number of matches is minus that of the best candidate. ``limits``: as in
    :func:`next_pair`, then the maximum number of candidates of a pair. ``need``: minimum number of detections that
    support a pair. ``groups``: see ``pyramid.identify_lost``. ``least``: minimum number of matches.
    """
    unit, sigma_rad = view[1], view[2]
    first, second, table_rad, offsets, pairs = table
    n = brightest
    geometry_of = geometry(unit[:n], sigma_rad[:n], sigmas, scale_error)
    start, stop = np.zeros((n, n), np.int64), np.zeros((n, n), np.int64)
    for i in range(n):
        for k in range(i + 1, n):
            d, t = geometry_of[0][i, k], geometry_of[1][i, k]
            start[i, k] = start[k, i] = np.searchsorted(table_rad, max(d - t, 0.0))
            stop[i, k] = stop[k, i] = np.searchsorted(table_rad, d + t, side="right")
    count_of_stars = len(sky[0])
    marks = np.empty((n, count_of_stars, (n + WORD - 1) // WORD + 1), np.uint32), np.zeros(n, np.bool_)
    state = np.array([1, 0, 0, 0], np.int64)
    out = np.empty((limits[4], 5), np.int64)
    work = workspace(count_of_stars, len(unit))
    best_count, best_predicted, best = 0, 0, 2.0
    while True:
        trials = next_pair(
            unit[:n],
            sky[0],
            (first, second, offsets, pairs),
            geometry_of,
            (start, stop),
            marks,
            state,
            (limits[0], limits[1], limits[2], float(limits[3]), need, groups),
            out,
        )
        if trials <= 0:
            return -best_count, best_predicted, best, state[2], trials == TOO_LONG
        i = state[1] - 1
        j = state[0] - i
        for t in range(trials):
            rows[0], rows[1], rows[2] = i, j, out[t, 2]
            stars[0], stars[1], stars[2] = out[t, 0], out[t, 1], out[t, 3]
            count, predicted, chance = verify(view, sky, camera, work, rows, stars, 3, float(state[2]), turn)
            if count < least:
                continue
            if chance <= accept:
                return count, predicted, chance, state[2], False
            if chance < best:
                best_count, best_predicted, best = count, predicted, chance

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
def _anchor(i, distance, tolerance, table_rad, first, second, start, stop, offsets, pool_k, pool_c, used):
    """Store the candidates of all pairs with star i in the pool from row ``used`` on, grouped by the catalogue star of
    i. Return the pool, which can be a larger copy, and the end of the rows used."""
    n, stars = len(distance), len(offsets) - 1
    offsets[:] = 0
    total = 0
    for k in range(n):
        if k == i:
            continue
        low, high = max(distance[i, k] - tolerance[i, k], 0.0), distance[i, k] + tolerance[i, k]
        start[k] = np.searchsorted(table_rad, low)
        stop[k] = np.searchsorted(table_rad, high, side="right")
        total += 2 * max(stop[k] - start[k], 0)
        for p in range(start[k], stop[k]):
            offsets[first[p] + 1] += 1
            offsets[second[p] + 1] += 1
    if used + total > len(pool_k):
        size = max(2 * len(pool_k), used + total)
        more_k, more_c = np.empty(size, np.int16), np.empty(size, np.int32)
        more_k[:used], more_c[:used] = pool_k[:used], pool_c[:used]
        pool_k, pool_c = more_k, more_c
    offsets[0] = used
    for s in range(stars):
        offsets[s + 1] += offsets[s]
    next_row = offsets[:stars].copy()
    for k in range(n):
        if k == i:
            continue
        for p in range(start[k], stop[k]):
            a, b = first[p], second[p]
            pool_k[next_row[a]], pool_c[next_row[a]] = k, b
            next_row[a] += 1
            pool_k[next_row[b]], pool_c[next_row[b]] = k, a
            next_row[b] += 1
    return pool_k, pool_c, used + total


@loop
def _join(
    i, j, h_first, h_second, slices, offsets, pool_k, pool_c, icrs, unit, handedness, flat, middle, half, need, out
):
    """Write the best supported hypotheses of the pair (i, j) to ``out``: rows (star of i, star of j, third, star of the
    third, votes). Return their number."""
    count = 0
    for side in range(2):
        for p in range(slices[0], slices[1]):
            a, b = (h_first[p], h_second[p]) if side == 0 else (h_second[p], h_first[p])
            bx, by, bz = icrs[b, 0], icrs[b, 1], icrs[b, 2]
            ax, ay, az = icrs[a, 0], icrs[a, 1], icrs[a, 2]
            nx, ny, nz = ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx
            votes, third, its, widest = 0, -1, -1, -1.0
            for q in range(offsets[a], offsets[a + 1]):
                k, c = pool_k[q], pool_c[q]
                off = -middle[j, k] + bx * icrs[c, 0] + by * icrs[c, 1] + bz * icrs[c, 2]
                if abs(off) > half[j, k] or k == j or c == b:
                    continue
                triple = nx * icrs[c, 0] + ny * icrs[c, 1] + nz * icrs[c, 2]
                wide = abs(handedness[k])
                # Nearly collinear triangles have no reliable handedness; they are tested later on the whole field.
                if not (handedness[k] * triple > 0 or max(wide, abs(triple)) < flat[k]):
                    continue
                votes += 1
                if wide > widest or (wide == widest and k == third and c < its):
                    widest, third, its = wide, k, c
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
def next_pair(unit, icrs, table, geometry_of, anchors, pool_k, pool_c, state, limits, out):
    """Examine pairs in order from ``state`` until one has candidates. Return their number, EXHAUSTED or TOO_LONG, and
    the pool.

    ``state``: sum of the rows of the next pair, its first row, number of hypotheses, joined rows, used rows of the
    pool. ``limits``: rows per pair, rows of one join, rows in total, COLLINEAR.
    """
    first, second, table_rad = table
    distance, tolerance, middle, half = geometry_of
    built, offsets, start, stop = anchors
    n = len(unit)
    handedness, flat = np.empty(n), np.empty(n)
    need = min(2, n - 2)
    while state[0] < 2 * n - 2:
        total, i = state[0], state[1]
        if i >= (total + 1) // 2:
            state[0] = total + 1
            state[1] = max(0, total + 1 - n + 1)
            continue
        j = total - i
        if state[3] > limits[2]:
            return TOO_LONG, pool_k, pool_c
        state[1] = i + 1
        if not built[i]:
            pool_k, pool_c, used = _anchor(
                i,
                distance,
                tolerance,
                table_rad,
                first,
                second,
                start[i],
                stop[i],
                offsets[i],
                pool_k,
                pool_c,
                state[4],
            )
            state[4] = used
            built[i] = True
        s, e = start[i, j], stop[i, j]
        if e <= s:
            continue
        state[2] += 2 * (e - s)
        rows = 0
        for p in range(s, e):
            rows += offsets[i, first[p] + 1] - offsets[i, first[p]] + offsets[i, second[p] + 1] - offsets[i, second[p]]
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
            i,
            j,
            first,
            second,
            (s, e),
            offsets[i],
            pool_k,
            pool_c,
            icrs,
            unit,
            handedness,
            flat,
            middle,
            half,
            need,
            out,
        )
        if count:
            return count, pool_k, pool_c
    return EXHAUSTED, pool_k, pool_c


@loop
def find(view, sky, table, camera, brightest, scale_error, sigmas, limits, accept, least, rows, stars, turn):
    """Examine pairs of the ``brightest`` detections, verify their hypotheses, and stop at the first whose false-match
    probability is at most ``accept``. Write its matches and rotation.

    Returns the number of matches, predicted stars, false-match probability, hypotheses, and True if the budget was used
    up. If no candidate is accepted, the number of matches is minus that of the best candidate. ``limits``: as in
    :func:`next_pair`, then the maximum number of candidates of a pair and the initial size of the pool. ``least``:
    minimum number of matches.
    """
    unit, sigma_rad = view[1], view[2]
    n = brightest
    geometry_of = geometry(unit[:n], sigma_rad[:n], sigmas, scale_error)
    count_of_stars = len(sky[0])
    anchors = (
        np.zeros(n, np.bool_),
        np.empty((n, count_of_stars + 1), np.int64),
        np.zeros((n, n), np.int64),
        np.zeros((n, n), np.int64),
    )
    pool_k, pool_c = np.empty(limits[5], np.int16), np.empty(limits[5], np.int32)
    state = np.array([1, 0, 0, 0, 0], np.int64)
    out = np.empty((limits[4], 5), np.int64)
    work = workspace(count_of_stars, len(unit))
    join_limits = (limits[0], limits[1], limits[2], float(limits[3]))
    best_count, best_predicted, best = 0, 0, 2.0
    while True:
        trials, pool_k, pool_c = next_pair(
            unit[:n], sky[0], table, geometry_of, anchors, pool_k, pool_c, state, join_limits, out
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

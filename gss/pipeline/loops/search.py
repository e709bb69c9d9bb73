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
BITS, MARKED = 32, 8.0
"""BITS: marks are used for at most this many detections, one bit each. MARKED: marks are used only if a catalogue star is
in at most this many matching pairs on average, estimated from the brightest detection. Marks reject unsupported
hypotheses faster than lists."""
FIRST_POOL_ROWS = 1 << 16


@loop
def _compute_pairs(i, detections, table_rad, pair_geometry):
    """Compute the pairs of detection i with the others, if they are not computed yet: distance and tolerance, middle and
    half width of the range of the cosine, and first and last + 1 row of the distance table. Computed on first use,
    because most star lists need the pairs of only two detections."""
    unit, sigma_rad, sigmas, scale_error = detections
    distance, tolerance, middle, half, start, stop, is_computed = pair_geometry
    if is_computed[i]:
        return
    is_computed[i] = True
    for k in range(len(unit)):
        if is_computed[k]:
            continue  # symmetrical
        x, y, z = unit[i, 0] - unit[k, 0], unit[i, 1] - unit[k, 1], unit[i, 2] - unit[k, 2]
        d = 2 * math.asin(min(1.0, math.sqrt(x * x + y * y + z * z) / 2))
        t = sigmas * math.sqrt(sigma_rad[i] ** 2 + sigma_rad[k] ** 2) + scale_error * d
        near, far = math.cos(max(d - t, 0.0)), math.cos(d + t)
        distance[i, k] = distance[k, i] = d
        tolerance[i, k] = tolerance[k, i] = t
        middle[i, k] = middle[k, i] = (far + near) / 2
        half[i, k] = half[k, i] = (near - far) / 2
        start[i, k] = start[k, i] = np.searchsorted(table_rad, max(d - t, 0.0))
        stop[i, k] = stop[k, i] = np.searchsorted(table_rad, d + t, side="right")


@loop
def _no_pairs(n):
    """Return the arrays for the pairs of n detections, none computed; see :func:`_compute_pairs`."""
    return (
        np.zeros((n, n)),
        np.zeros((n, n)),
        np.zeros((n, n)),
        np.zeros((n, n)),
        np.zeros((n, n), np.int64),
        np.zeros((n, n), np.int64),
        np.zeros(n, np.bool_),
    )


@loop
def _mark(i, start, stop, first, second, mark):
    """Mark the catalogue stars that star i can be. ``mark`` (stars, 2): bit k is set if the pair with star k allows it;
    number of these pairs of the table."""
    mark[:] = 0
    one = np.uint32(1)
    for k in range(len(start)):
        if k == i:
            continue
        bit = one << np.uint32(k)
        for p in range(start[k], stop[k]):
            for s in (first[p], second[p]):
                mark[s, 0] |= bit
                mark[s, 1] += one


@loop
def _list(i, start, stop, first, second, offsets, pool_k, pool_c, used):
    """List for each catalogue star that star i can be the other stars and their detections, in the pool from row ``used``
    on. Return the pool, which can be a larger copy, and the end of the rows used."""
    stars = len(offsets) - 1
    offsets[:] = 0
    total = 0
    for k in range(len(start)):
        if k == i:
            continue
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
    for k in range(len(start)):
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
def _fits(b, c, normal, icrs, middle, half, handedness, flat):
    """True if star c has the right distance from star b, and the triangle has the right handedness."""
    off = -middle + icrs[b, 0] * icrs[c, 0] + icrs[b, 1] * icrs[c, 1] + icrs[b, 2] * icrs[c, 2]
    if abs(off) > half or c == b:
        return False
    triple = normal[0] * icrs[c, 0] + normal[1] * icrs[c, 1] + normal[2] * icrs[c, 2]
    # Nearly collinear triangles have no reliable handedness; they are tested later on the whole field.
    return handedness * triple > 0 or max(abs(handedness), abs(triple)) < flat


@loop
def _normal(icrs, a, b):
    ax, ay, az = icrs[a, 0], icrs[a, 1], icrs[a, 2]
    bx, by, bz = icrs[b, 0], icrs[b, 1], icrs[b, 2]
    return ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx


@loop
def _insert(out, count, a, b, third, its, votes):
    """Insert a hypothesis into the ``count`` best ones. Return their number."""
    if count == len(out) and votes <= out[count - 1, 4]:
        return count
    slot = count if count < len(out) else count - 1
    while slot > 0 and out[slot - 1, 4] < votes:
        out[slot] = out[slot - 1]
        slot -= 1
    out[slot, 0], out[slot, 1], out[slot, 2], out[slot, 3], out[slot, 4] = a, b, third, its, votes
    return min(count + 1, len(out))


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
def _join_marks(i, j, table, start, stop, mark_i, mark_j, icrs, handedness, flat, middle, half, need, out):
    """Write the best supported hypotheses of the pair (i, j) to ``out``: rows (star of i, star of j, third, star of the
    third, votes). Return their number. Third stars are looked up only if enough bits are set for both stars."""
    first, second, offsets, pairs, partner = table
    one = np.uint32(1)
    count = 0
    for side in range(2):
        for p in range(start[j], stop[j]):
            a, b = (first[p], second[p]) if side == 0 else (second[p], first[p])
            both = mark_i[a, 0] & mark_j[b, 0]
            common, bits = 0, both
            while bits:
                bits &= bits - one
                common += 1
            if common < need:
                continue
            normal = _normal(icrs, a, b)
            votes, third, its, widest = 0, -1, -1, -1.0
            k = -1
            while common > 0 and votes + common >= need:
                k += 1
                if not both >> np.uint32(k) & one:
                    continue
                common -= 1
                star = -1
                q = _first_pair(pairs, offsets[a], offsets[a + 1], start[k])
                while q < offsets[a + 1] and pairs[q] < stop[k]:
                    c = partner[q]
                    q += 1
                    if _fits(b, c, normal, icrs, middle[j, k], half[j, k], handedness[k], flat[k]):
                        star = c if star < 0 else min(star, c)
                if star >= 0:
                    votes += 1
                    if abs(handedness[k]) > widest:
                        widest, third, its = abs(handedness[k]), k, star
            if votes >= need:
                count = _insert(out, count, a, b, third, its, votes)
    return count


@loop
def _join_lists(i, j, table, start, stop, lists, icrs, handedness, flat, middle, half, need, out):
    """Write the best supported hypotheses as :func:`_join_marks`."""
    first, second = table
    offsets, pool_k, pool_c = lists
    count = 0
    for side in range(2):
        for p in range(start[j], stop[j]):
            a, b = (first[p], second[p]) if side == 0 else (second[p], first[p])
            normal = _normal(icrs, a, b)
            votes, voter, third, its, widest = 0, -1, -1, -1, -1.0
            for q in range(offsets[a], offsets[a + 1]):
                k, c = pool_k[q], pool_c[q]
                if k == j or not _fits(b, c, normal, icrs, middle[j, k], half[j, k], handedness[k], flat[k]):
                    continue
                votes += k != voter
                voter = k
                wide = abs(handedness[k])
                if wide > widest or (k == third and c < its):
                    widest, third, its = wide, k, c
            if votes >= need:
                count = _insert(out, count, a, b, third, its, votes)
    return count


@loop
def next_pair(detections, icrs, table, pair_geometry, candidates_of, pool, state, limits, out):
    """Examine pairs in order from ``state`` until one has candidates. Return their number, EXHAUSTED or TOO_LONG, and
    the pool.

    ``table``: first and second stars of the pairs, their distances, and the pairs by star (``DistanceTable.by_star``).
    ``pair_geometry``: see :func:`_compute_pairs`. ``candidates_of``: marks (:func:`_mark`), empty if lists are used, and
    lists (:func:`_list`), each followed by an array that is True where they are made. ``state``: sum of the rows of the
    next pair, its first row, number of hypotheses, joined rows, used rows of the pool. ``limits``: rows per pair, rows of
    one join, rows in total, COLLINEAR, minimum number of supporting detections, groups.
    """
    unit = detections[0]
    distance, tolerance, middle, half, start, stop, _ = pair_geometry
    first, second, table_rad, by_star, pairs, partner = table
    mark, is_marked, offsets, is_listed = candidates_of
    pool_k, pool_c = pool
    n, by_marks = len(unit), len(mark) > 0
    handedness, flat = np.empty(n), np.empty(n)
    while state[0] < 2 * n - 2:
        total, i = state[0], state[1]
        if i >= (total + 1) // 2:
            state[0] = total + 1
            state[1] = max(0, total + 1 - n + 1)
            continue
        j = total - i
        if state[3] > limits[2]:
            return TOO_LONG, (pool_k, pool_c)
        state[1] = i + 1
        if (j - i) % limits[5]:
            continue
        _compute_pairs(i, detections, table_rad, pair_geometry)
        if stop[i, j] <= start[i, j]:
            continue
        _compute_pairs(j, detections, table_rad, pair_geometry)
        state[2] += 2 * (stop[i, j] - start[i, j])
        rows = 0
        if by_marks:
            for k in (i, j):
                if not is_marked[k]:
                    _mark(k, start[k], stop[k], first, second, mark[k])
                    is_marked[k] = True
            for p in range(start[i, j], stop[i, j]):
                rows += int(mark[i, first[p], 1]) + int(mark[i, second[p], 1])
        else:
            if not is_listed[i]:
                pool_k, pool_c, used = _list(i, start[i], stop[i], first, second, offsets[i], pool_k, pool_c, state[4])
                state[4] = used
                is_listed[i] = True
            for p in range(start[i, j], stop[i, j]):
                a, b = first[p], second[p]
                rows += offsets[i, a + 1] - offsets[i, a] + offsets[i, b + 1] - offsets[i, b]
        state[3] += rows + limits[0]
        if rows > limits[1]:
            continue  # too unspecific to be evidence
        cx = unit[i, 1] * unit[j, 2] - unit[i, 2] * unit[j, 1]
        cy = unit[i, 2] * unit[j, 0] - unit[i, 0] * unit[j, 2]
        cz = unit[i, 0] * unit[j, 1] - unit[i, 1] * unit[j, 0]
        for k in range(n):
            handedness[k] = unit[k, 0] * cx + unit[k, 1] * cy + unit[k, 2] * cz
            flat[k] = limits[3] * tolerance[i, j] * max(distance[i, j], distance[i, k], distance[j, k])
        rest = icrs, handedness, flat, middle, half, limits[4], out
        if by_marks:
            of_stars = first, second, by_star, pairs, partner
            count = _join_marks(i, j, of_stars, start[i], stop[i], mark[i], mark[j], *rest)
        else:
            count = _join_lists(i, j, (first, second), start[i], stop[i], (offsets[i], pool_k, pool_c), *rest)
        if count:
            return count, (pool_k, pool_c)
    return EXHAUSTED, (pool_k, pool_c)


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
    n, count_of_stars = brightest, len(sky[0])
    detections = view[1][:n], view[2][:n], sigmas, scale_error
    pair_geometry = _no_pairs(n)
    _compute_pairs(0, detections, table[2], pair_geometry)
    is_sparse = 2 * (pair_geometry[5][0] - pair_geometry[4][0]).sum() <= MARKED * count_of_stars
    marked, listed = (n, 0) if n <= BITS and is_sparse else (0, n)
    candidates_of = (
        np.empty((marked, count_of_stars, 2), np.uint32),
        np.zeros(n, np.bool_),
        np.empty((listed, count_of_stars + 1), np.int64),
        np.zeros(n, np.bool_),
    )
    pool = np.empty(FIRST_POOL_ROWS, np.int16), np.empty(FIRST_POOL_ROWS, np.int32)
    state = np.array([1, 0, 0, 0, 0], np.int64)
    out = np.empty((limits[4], 5), np.int64)
    work = workspace(count_of_stars, len(view[0]))
    pair_limits = limits[0], limits[1], limits[2], float(limits[3]), need, groups
    best_count, best_predicted, best = 0, 0, 2.0
    while True:
        trials, pool = next_pair(detections, sky[0], table, pair_geometry, candidates_of, pool, state, pair_limits, out)
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

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
WORD = 64
MAX_BITS, MAX_WORDS = 32, 10
"""Largest number of bits of a detection in a mark, and largest length of a mark in words."""
ACCIDENTAL = 0.08
"""Expected number of detections, relative to the required number, that marks do not exclude although they support no
hypothesis."""


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
def _bits_of_a_detection(pairs_of_a_star, detections, need):
    """Return the number of bits of each detection in a mark. ``pairs_of_a_star``: average number of pairs of one detection
    with all others that a catalogue star can be part of."""
    bits = 1
    each = pairs_of_a_star / max(detections - 1, 1)
    while (
        bits < MAX_BITS
        and 2 * bits * detections <= WORD * MAX_WORDS
        and detections * each * each > ACCIDENTAL * need * bits
    ):
        bits *= 2
    return bits


@loop
def _mark(i, start, stop, first, second, bits, marks):
    """Write the marks (stars, words) of the catalogue stars that detection i can be. In a mark, each detection k has
    ``bits`` bits. A bit is set if a pair of i and k allows it, and the row of the star of k gives its number. Two stars
    can be those of i and j, with support by k, only if their marks have a common bit of k."""
    marks[:] = 0
    one, last = np.uint64(1), np.uint64(bits - 1)  # unsigned numbers, because signed ones need tests and more time
    for k in range(len(start)):
        if k == i:
            continue
        word, shift = np.uint64(k * bits // WORD), np.uint64(k * bits % WORD)
        for p in range(start[k], stop[k]):
            a, b = np.uint64(first[p]), np.uint64(second[p])
            marks[a, word] |= one << (shift + (b & last))
            marks[b, word] |= one << (shift + (a & last))


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
def _join(i, j, table, start, stop, bits, marks_i, marks_j, icrs, handedness, flat, middle, half, need, out):
    """Write the best supported hypotheses of the pair (i, j) to ``out``: rows (star of i, star of j, third, star of the
    third, votes). Return their number. Third stars are looked up only if the marks have enough bits in common."""
    first, second, offsets, pairs, partner = table
    one, all_of_one = np.uint64(1), (np.uint64(1) << np.uint64(bits)) - np.uint64(1)
    words = marks_i.shape[1]
    count = 0
    for side in range(2):
        for p in range(start[j], stop[j]):
            a, b = (first[p], second[p]) if side == 0 else (second[p], first[p])
            common = 0
            for word in range(words):
                rest = marks_i[a, word] & marks_j[b, word]
                while rest:
                    rest &= rest - one
                    common += 1
            if common < need:
                continue
            normal = _normal(icrs, a, b)
            votes, third, its, widest = 0, -1, -1, -1.0
            word, shift = 0, -bits
            for k in range(len(start)):
                shift += bits
                if shift == WORD:
                    word, shift = word + 1, 0
                if not (marks_i[a, word] & marks_j[b, word]) >> np.uint64(shift) & all_of_one:
                    continue
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
def next_pair(detections, icrs, table, pair_geometry, bits, marks, is_marked, state, limits, out):
    """Examine pairs in order from ``state`` until one has candidates. Return their number, EXHAUSTED or TOO_LONG.

    ``table``: first and second stars of the pairs, their distances, and the pairs by star (``DistanceTable.by_star``).
    ``pair_geometry``: see :func:`_compute_pairs`. ``marks`` (detections, stars, words): see :func:`_mark`. ``is_marked``:
    True where they are made. ``state``: sum of the rows of the next pair, its first row, number of hypotheses.
    ``limits``: hypotheses of one pair, hypotheses in total, COLLINEAR, minimum number of supporting detections, groups.
    """
    unit = detections[0]
    distance, tolerance, middle, half, start, stop, _ = pair_geometry
    first, second, table_rad, by_star, pairs, partner = table
    n = len(unit)
    handedness, flat = np.empty(n), np.empty(n)
    while state[0] < 2 * n - 2:
        total, i = state[0], state[1]
        if i >= (total + 1) // 2:
            state[0] = total + 1
            state[1] = max(0, total + 1 - n + 1)
            continue
        j = total - i
        if state[2] > limits[1]:
            return TOO_LONG
        state[1] = i + 1
        if (j - i) % limits[4]:
            continue
        _compute_pairs(i, detections, table_rad, pair_geometry)
        if stop[i, j] <= start[i, j]:
            continue
        hypotheses = 2 * (stop[i, j] - start[i, j])
        state[2] += hypotheses
        if hypotheses > limits[0]:
            continue  # too unspecific to be evidence
        _compute_pairs(j, detections, table_rad, pair_geometry)
        for k in (i, j):
            if not is_marked[k]:
                _mark(k, start[k], stop[k], first, second, bits, marks[k])
                is_marked[k] = True
        cx = unit[i, 1] * unit[j, 2] - unit[i, 2] * unit[j, 1]
        cy = unit[i, 2] * unit[j, 0] - unit[i, 0] * unit[j, 2]
        cz = unit[i, 0] * unit[j, 1] - unit[i, 1] * unit[j, 0]
        for k in range(n):
            handedness[k] = unit[k, 0] * cx + unit[k, 1] * cy + unit[k, 2] * cz
            flat[k] = limits[2] * tolerance[i, j] * max(distance[i, j], distance[i, k], distance[j, k])
        of_stars = first, second, by_star, pairs, partner
        rest = icrs, handedness, flat, middle, half, limits[3], out
        count = _join(i, j, of_stars, start[i], stop[i], bits, marks[i], marks[j], *rest)
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
    n, count_of_stars = brightest, len(sky[0])
    detections = view[1][:n], view[2][:n], sigmas, scale_error
    pair_geometry = _no_pairs(n)
    _compute_pairs(0, detections, table[2], pair_geometry)
    pairs_of_a_star = 2 * (pair_geometry[5][0] - pair_geometry[4][0]).sum() / count_of_stars
    bits = _bits_of_a_detection(pairs_of_a_star, n, need)
    marks = np.empty((n, count_of_stars, (n * bits + WORD - 1) // WORD), np.uint64)
    is_marked = np.zeros(n, np.bool_)
    state = np.array([1, 0, 0], np.int64)
    out = np.empty((limits[3], 5), np.int64)
    work = workspace(count_of_stars, len(view[0]))
    pair_limits = limits[0], limits[1], float(limits[2]), need, groups
    best_count, best_predicted, best = 0, 0, 2.0
    while True:
        trials = next_pair(detections, sky[0], table, pair_geometry, bits, marks, is_marked, state, pair_limits, out)
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

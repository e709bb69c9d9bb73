"""Compiled search for identification without a prior attitude; equivalent to ``anchor_search.AnchorSearch`` and
``pyramid.identify_lost``."""

# The loops have no type annotations: numba compiles them for the argument types. Indices are unsigned where possible,
# because signed ones need tests for negative numbers and more time.
# mypy: allow-untyped-defs

from __future__ import annotations

import math

import numpy as np

from gss.pipeline.identify.anchor_search import SMALLEST_GROUP, next_size
from gss.pipeline.loops import loop
from gss.pipeline.loops.proof import prepared, verify, without_one, workspace

_next_size = loop(next_size)
STAR_BITS = np.uint32(24)
"""Bits of the star in an entry; the others contain the detection."""
STAR_MASK = np.uint32(2**24 - 1)


@loop
def _no_pairs(n):
    """Return arrays for the pairs of n detections: distance and tolerance, middle and half width of the range of the cosine,
    and first and last + 1 row of the distance table; the last is -1 until the pair is computed."""
    return (
        np.empty((n, n)),
        np.empty((n, n)),
        np.empty((n, n)),
        np.empty((n, n)),
        np.empty((n, n), np.int64),
        np.full((n, n), -1, np.int64),
    )


@loop
def _compute_pairs(first, end, detections, table_rad, pairs):
    """Compute the pairs of the detections from ``first`` to ``end`` that are not yet computed."""
    unit, sigma_rad, sigmas, scale_error = detections
    distance, tolerance, middle, half, start, stop = pairs
    for k in range(first, end):
        for i in range(first, k):
            if stop[i, k] >= 0:
                continue
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
def _ranks(first, end, pairs, largest):
    """Return the number of hypotheses of all pairs of the detections from ``first`` to ``end``, up to each sum of their rows
    in this group."""
    start, stop = pairs[4:]
    ranks = np.zeros(2 * (end - first), np.int64)
    for k in range(first, end):
        for i in range(first, k):
            hypotheses = 2 * (stop[i, k] - start[i, k])
            if hypotheses <= largest:
                ranks[i + k - 2 * first] += hypotheses
    return np.cumsum(ranks)


@loop
def _entries(i, count, pairs, table, largest, need, end, anchor, entry):
    """Write an entry for each hypothesis that detection i is one star and a later one of ``count`` is another: detection
    and star of the other, grouped by the star of i. Stars with at most ``need`` entries cannot be a candidate: their entries go
    to the first place of ``entry``, which has no meaning. ``anchor``: the other stars; ``end``: index after the last entry
    of each. Return the number of these stars, their largest number of entries, and ``entry``, which is replaced if it is
    too short."""
    start, stop = pairs[4:]
    first, second = table[:2]
    zero, one = np.uint32(0), np.uint32(1)
    end[:] = 0
    for k in range(i + 1, count):
        if 2 * (stop[i, k] - start[i, k]) <= largest:
            for p in range(np.uint64(start[i, k]), np.uint64(stop[i, k])):
                end[np.uint32(first[p])] += one
                end[np.uint32(second[p])] += one
    # No branches in these loops: a processor cannot predict which stars have enough entries.
    at, most, anchors, few = one, zero, np.uint64(0), np.uint32(need)
    for star in range(len(end)):
        of_star = end[star] if end[star] > few else zero
        anchor[anchors] = star
        anchors += np.uint64(of_star > zero)
        most = max(most, of_star)
        end[star] = at if of_star > zero else zero
        at += of_star
    if at > len(entry):
        entry = np.empty(at, np.uint32)
    for k in range(i + 1, count):
        if 2 * (stop[i, k] - start[i, k]) <= largest:
            detection = np.uint32(k) << STAR_BITS
            for p in range(np.uint64(start[i, k]), np.uint64(stop[i, k])):
                a, b = np.uint32(first[p]), np.uint32(second[p])
                place = end[a]
                entry[place] = detection | b
                end[a] = place + np.uint32(place > zero)
                place = end[b]
                entry[place] = detection | a
                end[b] = place + np.uint32(place > zero)
    return anchors, most, entry


@loop
def _triple(v, a, b, c):
    """Return the triple product of three rows."""
    return (
        v[a, 0] * (v[b, 1] * v[c, 2] - v[b, 2] * v[c, 1])
        + v[a, 1] * (v[b, 2] * v[c, 0] - v[b, 0] * v[c, 2])
        + v[a, 2] * (v[b, 0] * v[c, 1] - v[b, 1] * v[c, 0])
    )


@loop
def _same_handedness(measured, listed, i, k, m, pairs, collinear):
    """True if the triple products of the detections i, k and m and of their stars have the same sign, or are too small for
    a reliable sign: nearly collinear triangles are tested later on the whole field."""
    distance, tolerance = pairs[:2]
    longest = max(distance[i, k], distance[i, m], distance[k, m])
    flat = collinear * max(tolerance[i, k], tolerance[i, m]) * longest
    return measured * listed > 0 or max(abs(measured), abs(listed)) < flat


@loop
def _insert(out, count, candidate, votes):
    """Insert a candidate into the ``count`` ones with most votes. Return their number."""
    if count == len(out) and votes <= out[count - 1, 5]:
        return count
    slot = count if count < len(out) else count - 1
    while slot > 0 and out[slot - 1, 5] < votes:
        out[slot] = out[slot - 1]
        slot -= 1
    for column in range(5):
        out[slot, column] = candidate[column]
    out[slot, 5] = votes
    return min(count + 1, len(out))


@loop
def _candidates(i, unit, icrs, pairs, anchor, end, most, entry, collinear, need, out):
    """Write the candidates of anchor i to ``out``, those with most votes first: rows (star of i, detection, its star, third
    detection, its star, votes). Return their number. An entry has a vote for every other detection
    of which an entry of the same star fits its distance and handedness."""
    middle, half = pairs[2:4]
    x, y, z = np.empty(most), np.empty(most), np.empty(most)
    detection, star = np.empty(most, np.uint32), np.empty(most, np.uint32)
    votes, latest = np.empty(most, np.int64), np.empty(most, np.int64)
    stop, one = np.uint64(1), np.uint64(1)
    count = 0
    for a in anchor:
        start, stop = stop, np.uint64(end[a])
        n = stop - start
        for e in range(n):
            c = entry[start + e] & STAR_MASK
            detection[e], star[e] = entry[start + e] >> STAR_BITS, c
            x[e], y[e], z[e] = icrs[c, 0], icrs[c, 1], icrs[c, 2]
            votes[e], latest[e] = 0, -1
        most_votes = 0
        for e in range(n - one):
            if most_votes + np.int64(n - e - one) < need:
                break  # no entry can have enough votes
            k, c, xe, ye, ze = detection[e], star[e], x[e], y[e], z[e]
            for f in range(e + one, n):
                m, d = detection[f], star[f]
                if abs(xe * x[f] + ye * y[f] + ze * z[f] - middle[k, m]) > half[k, m] or k == m or c == d:
                    continue
                if not _same_handedness(_triple(unit, i, k, m), _triple(icrs, a, c, d), i, k, m, pairs, collinear):
                    continue
                # A detection votes once, whatever stars it can be; its entries follow each other.
                if latest[e] != m:
                    latest[e] = m
                    votes[e] += 1
                if latest[f] != k:
                    latest[f] = k
                    votes[f] += 1
                most_votes = max(most_votes, votes[e], votes[f])
        if most_votes < need:
            continue
        for e in range(n):
            if votes[e] < need:
                continue
            k, c = detection[e], star[e]
            third, third_star, widest = np.uint32(0), np.uint32(0), -1.0
            for f in range(n):
                m, d = detection[f], star[f]
                off = x[e] * x[f] + y[e] * y[f] + z[e] * z[f] - middle[k, m]
                if abs(off) > half[k, m] or k == m or c == d:
                    continue
                triple = _triple(unit, i, k, m)
                if abs(triple) > widest and _same_handedness(triple, _triple(icrs, a, c, d), i, k, m, pairs, collinear):
                    third, third_star, widest = m, d, abs(triple)
            candidate = np.int64(a), np.int64(k), np.int64(c), np.int64(third), np.int64(third_star)
            count = _insert(out, count, candidate, votes[e])
    return count


@loop
def find(
    field,
    sky,
    table,
    camera,
    brightest,
    scale_error,
    sigmas,
    limits,
    need,
    accept,
    least,
    only_first,
    rows,
    stars,
    turn,
):
    """Take each of the ``brightest`` detections as an anchor, verify its candidates, and stop at the first whose
    false-match probability is at most ``accept``. Write its matches and rotation.

    Returns the number of matches, predicted stars, false-match probability, hypotheses (see ``PyramidMatch``), and True if
    the budget was used up. If no candidate is accepted, the number of matches is minus that of the best candidate.
    ``table``: first and second stars of the pairs, and their distances. ``limits``: hypotheses of one pair, hypotheses in
    total, COLLINEAR, candidates of an anchor. ``need``: minimum number of votes. ``least``: minimum number of matches.
    ``only_first``: see ``anchor_search.groups``.
    """
    view = prepared(field)
    icrs, unit = sky[0], view[1][:brightest]
    detections = unit, view[2][:brightest], sigmas, scale_error
    pairs = _no_pairs(brightest)
    end, anchor, entry = np.empty(len(icrs), np.uint32), np.empty(len(icrs), np.uint32), np.empty(0, np.uint32)
    out = np.empty((limits[3], 6), np.int64)
    work = workspace(len(icrs), len(view[0]))
    best_count, best_predicted, best = 0, 0, 2.0
    size = min(SMALLEST_GROUP, brightest)
    first = examined = before = 0
    while True:
        stop = min(first + size, brightest)
        _compute_pairs(first, stop, detections, table[2], pairs)
        ranks = before + _ranks(first, stop, pairs, limits[0])
        for i in range(first, stop - need - 1):
            if examined > limits[1]:
                return -best_count, best_predicted, best, examined, True
            for k in range(i + 1, stop):
                hypotheses = 2 * (pairs[5][i, k] - pairs[4][i, k])
                if hypotheses <= limits[0]:
                    examined += hypotheses
            anchors, most, entry = _entries(i, stop, pairs, table, limits[0], need, end, anchor, entry)
            trials = _candidates(i, unit, icrs, pairs, anchor[:anchors], end, most, entry, float(limits[2]), need, out)
            for t in range(trials):
                rows[0], rows[1], rows[2] = i, out[t, 1], out[t, 3]
                stars[0], stars[1], stars[2] = out[t, 0], out[t, 2], out[t, 4]
                rank = ranks[i + out[t, 1] - 2 * first]
                count, predicted, chance = verify(view, sky, camera, work, rows, stars, np.int64(3), float(rank), turn)
                if count < least:
                    continue
                if chance <= accept:
                    three = i, out[t, 1], out[t, 3]
                    count, predicted = without_one(
                        view, sky, camera, work, three, rows, stars, count, predicted, chance, float(rank), turn
                    )
                    return count, predicted, chance, rank, False
                if chance < best:
                    best_count, best_predicted, best = count, predicted, chance
        first, before = stop, ranks[-1]
        if stop == brightest or only_first:
            if size == brightest:
                return -best_count, best_predicted, best, examined, False
            first, before, size = 0, 0, _next_size(size, brightest)

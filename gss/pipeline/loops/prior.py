"""Compiled identification near a prior attitude; equivalent to ``identify.near``."""

# The loops have no type annotations: numba compiles them for the argument types.
# mypy: allow-untyped-defs

from __future__ import annotations

import math

import numpy as np

from gss.pipeline.identify.near import FEW_CANDIDATES
from gss.pipeline.loops import loop
from gss.pipeline.loops.cells import stars_near
from gss.pipeline.loops.proof import prepared, verify, without_one, workspace

NO_THREE = 2


@loop
def _candidates(unit, sigma_rad, n, icrs, local, near, prior, radius_rad, most, observed, star, expected):
    """Write the (detection, star) pairs within the radius, in the order of the detections. Return the number of
    pairs."""
    cam = np.empty((near, 3))
    for k in range(near):
        s = local[k]
        for i in range(3):
            cam[k, i] = prior[i, 0] * icrs[s, 0] + prior[i, 1] * icrs[s, 1] + prior[i, 2] * icrs[s, 2]
    count = 0
    for d in range(n):
        within2 = (2 * math.sin(radius_rad / 2) + 3 * sigma_rad[d]) ** 2
        for k in range(near):
            chord2 = 2 - 2 * (unit[d, 0] * cam[k, 0] + unit[d, 1] * cam[k, 1] + unit[d, 2] * cam[k, 2])
            if chord2 < within2:
                if count == most:
                    return count
                observed[count], star[count] = d, local[k]
                expected[count] = cam[k]
                count += 1
    return count


@loop
def _angle(a, b):
    half2 = 0.5 - 0.5 * (a[0] * b[0] + a[1] * b[1] + a[2] * b[2])
    return 2 * math.asin(math.sqrt(min(max(half2, 0.0), 1.0)))


@loop
def _agreement(unit, sigma_rad, observed, star, expected, count, sigmas):
    agree = np.zeros((count, count), np.bool_)
    for a in range(count):
        for b in range(a + 1, count):
            if observed[a] == observed[b] or star[a] == star[b]:
                continue
            tolerance = sigmas * math.sqrt(sigma_rad[observed[a]] ** 2 + sigma_rad[observed[b]] ** 2)
            if abs(_angle(unit[observed[a]], unit[observed[b]]) - _angle(expected[a], expected[b])) < tolerance:
                agree[a, b] = agree[b, a] = True
    return agree


@loop
def _partner(agree, p):
    """Return the candidate that agrees with ``p`` and with most of the other candidates that agree with ``p``."""
    best, max_shared = 0, -1
    for q in range(len(agree)):
        if agree[p, q]:
            common = 0
            for k in range(len(agree)):
                common += agree[q, k] and agree[p, k]
            if common > max_shared:
                best, max_shared = q, common
    return best


@loop
def _third(agree, p, q, unit, observed):
    """Return the candidate that agrees with ``p`` and ``q`` and gives the largest triangle, or -1."""
    best, max_area = -1, -1.0
    u, v = unit[observed[p]], unit[observed[q]]
    side = v - u
    side2 = side[0] * side[0] + side[1] * side[1] + side[2] * side[2]
    for k in range(len(agree)):
        if agree[p, k] and agree[q, k]:
            other = unit[observed[k]] - u
            along = side[0] * other[0] + side[1] * other[1] + side[2] * other[2]
            area2 = side2 * (other[0] * other[0] + other[1] * other[1] + other[2] * other[2]) - along * along
            if area2 > max_area:
                best, max_area = k, area2
    return best


@loop
def find_near(
    field, sky, camera, prior, radius_rad, reach_cosine, brightest, sigmas, most, tries, accept, rows, stars, turn
):
    """Identify with a prior attitude; equivalent to ``near.identify_near``. Returns the number of matches, predicted
    stars, false-match probability, hypotheses, and 0 or the reason FEW_CANDIDATES or NO_THREE. If no candidate is
    accepted, the number of matches is minus that of the best candidate, or 0."""
    view = prepared(field)
    unit, sigma_rad = view[1], view[2]
    icrs, _, cells = sky
    local = np.empty(len(icrs), np.int64)
    near = stars_near(icrs, cells, prior[2], reach_cosine, len(icrs), local)
    observed, star, expected = np.empty(most, np.int64), np.empty(most, np.int64), np.empty((most, 3))
    count = _candidates(
        unit, sigma_rad, brightest, icrs, local, near, prior, radius_rad, most, observed, star, expected
    )
    if count < 3:
        return 0, 0, 1.0, count, FEW_CANDIDATES
    agree = _agreement(unit, sigma_rad, observed, star, expected, count, sigmas)
    hypotheses = int(agree.sum()) // 2
    work = workspace(len(icrs), len(unit))
    best_count, best_predicted, best = 0, 0, 2.0
    for _ in range(tries):
        votes = agree.sum(axis=1)
        p = int(votes.argmax())
        if votes[p] < 2:
            break
        q = _partner(agree, p)
        third = _third(agree, p, q, unit, observed)
        if third < 0:
            agree[p, q] = agree[q, p] = False
            continue
        rows[0], rows[1], rows[2] = observed[p], observed[q], observed[third]
        stars[0], stars[1], stars[2] = star[p], star[q], star[third]
        tried = float(max(hypotheses, 1))
        matched, predicted, chance = verify(view, sky, camera, work, rows, stars, np.int64(3), tried, turn)
        if matched >= 3 and chance <= accept:
            three = observed[p], observed[q], observed[third]
            matched, predicted = without_one(
                view, sky, camera, work, three, rows, stars, matched, predicted, chance, tried, turn
            )
        if matched >= 3:
            cosine = ((turn * prior).sum() - 1) / 2
            if math.acos(min(max(cosine, -1.0), 1.0)) <= 2 * radius_rad + 0.01:
                if chance <= accept:
                    return matched, predicted, chance, hypotheses, 0
                if chance < best:
                    best_count, best_predicted, best = matched, predicted, chance
        agree[p] = False
        agree[:, p] = False
    return -best_count, best_predicted, best, hypotheses, NO_THREE if best_count == 0 else 0

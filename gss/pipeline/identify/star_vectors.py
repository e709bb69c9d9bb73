"""Star vectors (Baldini, as described in Jacobs 1995 §3.2.2, app. D.1): an alternative to match groups without distance
table.

The vector of an observed star contains all guide stars of its magnitude. Guide stars without a partner at the right
distance in the neighbouring vector are removed until nothing changes. The remaining guide stars are combined star by
star with backtracking. The method is fast and simple, but identifies only constellations that contain *all* observed
stars. A single false star makes it fail.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array, separation_rad
from gss.pipeline.identify.match_groups import (
    Grouping,
    GroupLimits,
    Guides,
    MatchGroup,
    Rows,
    group_of,
    mirrored,
    ranked,
    winner,
)

Flags = NDArray[np.bool_]


def match_star_vectors(unit: Array, v_mag: Array, guides: Guides, allowed: Flags, limits: GroupLimits) -> Grouping:
    """Identify like :func:`gss.pipeline.identify.match_groups.match_groups`, with the guide stars in the mask
    ``allowed``.

    ``pairs``: guide pairs that fit the first two observed stars. ``operations``: number of distances compared.
    """
    n = len(unit)
    if n < limits.min_group or not np.isfinite(unit).all():
        return Grouping(None, (), 0, 0, f"star vectors need {limits.min_group} stars")
    fits = (np.abs(v_mag[:, None] - guides.v_mag[None, :]) <= limits.magnitude_mag) & allowed
    vectors = [np.flatnonzero(row) for row in fits]
    first_pairs = int(np.count_nonzero(_partners(vectors[0], vectors[1], unit, 0, 1, guides, limits)))
    looked = _strike_out(vectors, unit, guides, limits)
    constellations, steps = _constellations(vectors, unit, guides, limits)
    operations = looked + steps
    if steps > limits.budget:
        return Grouping(None, (), first_pairs, operations, "too many constellations to combine")
    everyone = np.arange(n)
    groups: list[MatchGroup] = [group_of((everyone, rows), unit, guides) for rows in constellations]
    groups = [g for g in groups if not mirrored(g, unit, guides.unit)]
    if not groups:
        return Grouping(None, (), first_pairs, operations, f"no constellation of all {n} stars fits the catalogue")
    best, reason = winner(groups, unit, guides, limits)
    return Grouping(best, ranked(groups), first_pairs, operations, reason)


def _partners(a: Rows, b: Rows, unit: Array, i: int, j: int, guides: Guides, limits: GroupLimits) -> Flags:
    """Return the (len(a), len(b)) mask of guide pairs with the separation of observed stars i and j. Cosines are
    accurate enough because all stars are at least 0.25° apart."""
    apart = float(separation_rad(unit[i], unit[j]))
    cosine = guides.unit[a] @ guides.unit[b].T
    max_cosine, min_cosine = np.cos(max(0.0, apart - limits.distance_rad)), np.cos(apart + limits.distance_rad)
    return np.asarray((cosine <= max_cosine) & (cosine >= min_cosine) & (a[:, None] != b[None, :]))


def _strike_out(vectors: list[Rows], unit: Array, guides: Guides, limits: GroupLimits) -> int:
    """Shorten the vectors in place until none changes, by comparing each vector with the next in a ring. Returns the
    number of distances compared."""
    n, looked, still = len(vectors), 0, 0
    i = 0
    while still < n:
        j = (i + 1) % n
        looked += len(vectors[i]) * len(vectors[j])
        fit = _partners(vectors[i], vectors[j], unit, i, j, guides, limits)
        first_fit, second_fit = fit.any(axis=1), fit.any(axis=0)
        still = still + 1 if first_fit.all() and second_fit.all() else 0
        vectors[i], vectors[j] = vectors[i][first_fit], vectors[j][second_fit]
        i = j
    return looked


def _constellations(vectors: list[Rows], unit: Array, guides: Guides, limits: GroupLimits) -> tuple[list[Rows], int]:
    """Return all choices of one guide star per vector for which all distances fit, and the number of steps. Stops at the budget."""
    n = len(vectors)
    if any(len(v) == 0 for v in vectors):
        return [], 0
    fit = {(i, j): _partners(vectors[i], vectors[j], unit, i, j, guides, limits) for j in range(1, n) for i in range(j)}
    constellations: list[Rows] = []
    steps = 0

    def grow(places: list[int]) -> None:
        nonlocal steps
        steps += 1
        if steps > limits.budget:
            return
        j = len(places)
        if j == n:
            constellations.append(np.array([vectors[k][place] for k, place in enumerate(places)], np.intp))
            return
        open_ = np.ones(len(vectors[j]), bool)
        for i, place in enumerate(places):
            open_ &= fit[i, j][place]
        for place in np.flatnonzero(open_).tolist():
            grow([*places, place])

    grow([])
    return constellations, steps

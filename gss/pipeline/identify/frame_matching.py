"""Matching two frames of one camera without a catalogue: pair match and triangle match (Huffman 2006 §5.5.1–2).

Both compare angles within the first frame with angles within the second, so the rotation between the frames does not
matter. Results are (m, 2) rows of (star of frame 1, star of frame 2), empty without a match.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.pipeline.identify.n_vertex import FLATTEST, figures

Rows = NDArray[np.intp]
NOTHING = np.empty((0, 2), np.intp)


def angle_matrix_rad(unit_cam: Array) -> Array:
    """Return the (n, n) angles between (n, 3) directions (§5.5.2 step 2)."""
    half_chord = 0.5 * np.linalg.norm(unit_cam[:, None] - unit_cam[None], axis=2)
    return np.asarray(2 * np.arcsin(np.minimum(half_chord, 1.0)))


def pair_match(before: Array, after: Array, flux_before: Array, flux_after: Array, tolerance_rad: float) -> Rows:
    """Match two stars by their separation (§5.5.1). ``before``, ``after``: (n, 3) and (m, 3) directions, brightest
    first.

    Pairs are tried brightest first. A pair is accepted if exactly one pair of the other frame has the same separation;
    ambiguous separations do not match. The order of the two stars is determined by their brightness, which is the
    method of the document for an unknown motion.
    """
    angles_before, angles_after = angle_matrix_rad(before), angle_matrix_rad(after)
    a, b = np.triu_indices(len(after), 1)
    for i, j in figures(len(before), 2):
        close = np.flatnonzero(np.abs(angles_after[a, b] - angles_before[i, j]) <= tolerance_rad)
        if len(close) != 1:
            continue
        k, m = int(a[close[0]]), int(b[close[0]])
        if (flux_before[i] >= flux_before[j]) != (flux_after[k] >= flux_after[m]):
            k, m = m, k
        return np.array([[i, k], [j, m]], np.intp)
    return NOTHING


def triangle_match(before: Array, after: Array, tolerance_rad: float, most_figures: int = 500) -> Rows:
    """Match three stars by their three angles (§5.5.2). Returns the first triad, in the order of ``figures``, with
    exactly one partner."""
    angles_before, angles_after = angle_matrix_rad(before), angle_matrix_rad(after)
    for triad in figures(len(before), 3)[:most_figures]:
        partner = triad_partner(triad, before, after, angles_before, angles_after, tolerance_rad)
        if partner is not None:
            return np.column_stack([triad, partner])
    return NOTHING


def triad_partner(
    triad: tuple[int, ...], before: Array, after: Array, angles_before: Array, angles_after: Array, tolerance_rad: float
) -> Rows | None:
    """Return the (3,) matching stars of the other frame, or None unless exactly one triad of the same handedness fits."""
    sides = ((0, 1), (1, 2), (0, 2))
    alike = [np.abs(angles_after - angles_before[triad[p], triad[q]]) <= tolerance_rad for p, q in sides]
    for same in alike:
        np.fill_diagonal(same, False)
    matrix = candidate_star_matrix(*alike)
    if len(matrix) != 3:
        return None
    partner = np.array([np.max(matrix[:, column]) for column in range(3)], np.intp)
    before_volume, after_volume = np.linalg.det(before[list(triad)]), np.linalg.det(after[partner])
    if abs(before_volume) > FLATTEST and before_volume * after_volume < 0:
        return None
    return partner


def candidate_star_matrix(side_a: NDArray[np.bool_], side_b: NDArray[np.bool_], side_c: NDArray[np.bool_]) -> Rows:
    """Return the document's candidate star matrix after deletions; its columns are stars 1, 2, 3 of the triad, and −1
    is an empty cell.

    The (m, m) symmetric masks mark the pairs of the other frame that are as long as the sides a = 12, b = 23 and c =
    13. Every pair is entered in both orders. Rows with a star that occurs fewer than twice in its column are deleted
    repeatedly (the document deletes once). If three rows remain, they are a match. If more rows remain, the result is
    ambiguous.
    """
    rows = []
    for mask, (p, q) in zip((side_a, side_b, side_c), ((0, 1), (1, 2), (0, 2)), strict=True):
        i, j = np.nonzero(mask)
        block = np.full((len(i), 3), -1, np.intp)
        block[:, p], block[:, q] = i, j
        rows.append(block)
    matrix = np.concatenate(rows)
    size = max(len(side_a), 1)
    while len(matrix):
        often = np.stack([np.bincount(matrix[:, c] + 1, minlength=size + 1) for c in range(3)])
        often[:, 0] = 2
        keep = np.all([often[c][matrix[:, c] + 1] >= 2 for c in range(3)], axis=0)
        if keep.all():
            break
        matrix = matrix[keep]
    return matrix

"""Identification by triangle features and a vote among the candidates (Liebe 1992, "Initial estimate")."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import COSINE_ERROR, Array, separation_rad
from gss.domain.camera import Camera
from gss.skytables.triplets import TripletTable, features

Index = NDArray[np.intp]
OUTLINE_PER_SIDE = 64


@dataclass(frozen=True)
class TripletVote:
    """Result of the vote. ``row``: (n,) star-list row of each measured star, −1 if not identified. ``votes``: (n,)
    number of other measured stars that support it. ``triplet``: (t, 3) measured star, nearest, second nearest.
    ``which``, ``candidate``: (c,) matching references as row of ``triplet`` and row of the star list, best supported
    first. ``comparisons``: number of distances compared."""

    row: Index
    votes: Index
    triplet: Index
    which: Index
    candidate: Index
    comparisons: int


def rim_distance_rad(unit_cam: Array, camera: Camera) -> Array:
    """Return the (n,) angles to the nearest point of the detector's edge."""
    outline = camera.outline(OUTLINE_PER_SIDE)
    return np.asarray(separation_rad(unit_cam[:, None], outline[None]).min(axis=1))


def triplets_in_image(unit_cam: Array, camera: Camera) -> tuple[Index, Index, Index]:
    """Return the triplets (star, nearest, second nearest) of (n, 3) measured directions. A star that is closer to the
    edge than to its second neighbour is omitted, because a nearer neighbour could be outside the frame."""
    none = np.empty(0, np.intp)
    if len(unit_cam) < 3:
        return none, none, none
    distance = separation_rad(unit_cam[:, None], unit_cam[None])
    np.fill_diagonal(distance, np.inf)
    near = np.argsort(distance, axis=1, kind="stable")[:, :2]
    star = np.flatnonzero(distance[np.arange(len(near)), near[:, 1]] <= rim_distance_rad(unit_cam, camera))
    return star, near[star, 0], near[star, 1]


def vote(
    unit_cam: Array, camera: Camera, table: TripletTable, icrs: Array, allowed: NDArray[np.bool_], tolerance_rad: float
) -> TripletVote:
    """Find candidates of ``allowed`` rows in the triplet table.

    Candidates support each other if their distances equal the measured ones within ``tolerance_rad``. The best supported
    candidate and its supporters are returned.
    """
    n = len(unit_cam)
    row, votes, none = np.full(n, -1, np.intp), np.zeros(n, np.intp), np.empty(0, np.intp)
    star, first, second = triplets_in_image(unit_cam, camera)
    triplet = np.stack([star, first, second], axis=1)
    if not len(star):
        return TripletVote(row, votes, triplet, none, none, 0)
    triplet_row, entries = table.look_up(
        table.classes.key(*features(unit_cam[star], unit_cam[first], unit_cam[second]))
    )
    keep = np.flatnonzero(allowed[entries])
    triplet_row, candidate = triplet_row[keep], entries[keep].astype(np.intp)
    centroid = star[triplet_row]
    agree = agreement_of_candidates(unit_cam, centroid, icrs, candidate, tolerance_rad)
    # A measured star counts as one supporter, even if several of its candidates agree.
    support = np.zeros((len(centroid), n), bool)
    a, b = np.nonzero(agree)
    support[a, centroid[b]] = True
    count = support.sum(axis=1)
    chosen = consistent_set(agree, count)
    row[centroid[chosen]] = candidate[chosen]
    votes[centroid[chosen]] = count[chosen]
    order = np.argsort(-count, kind="stable")
    return TripletVote(row, votes, triplet, triplet_row[order], candidate[order], len(keep) * (len(keep) - 1) // 2)


def agreement_of_candidates(
    unit_cam: Array, centroid: Index, icrs: Array, candidate: Index, tolerance_rad: float
) -> NDArray[np.bool_]:
    """Return the (c, c) mask of candidate pairs for different stars with the measured distance. ``unit_cam``: (n, 3) finite."""
    reference = icrs[candidate]
    measured_rad = separation_rad(unit_cam[:, None], unit_cam[None])
    reach_rad = min(float(measured_rad.max(initial=0.0)) + tolerance_rad, np.pi)
    # Most pairs of candidates are further apart than any two measured stars.
    a, b = np.nonzero(reference @ reference.T >= np.cos(reach_rad) - COSINE_ERROR)
    off = np.abs(measured_rad[centroid[a], centroid[b]] - separation_rad(reference[a], reference[b]))
    agree = np.zeros((len(candidate), len(candidate)), bool)
    agree[a, b] = (off <= tolerance_rad) & (centroid[a] != centroid[b]) & (candidate[a] != candidate[b])
    return agree


def consistent_set(agree: NDArray[np.bool_], count: Index) -> Index:
    """Return the best supported candidate and, best first, every candidate that agrees with all candidates chosen before."""
    if not len(count) or not count.max():
        return np.empty(0, np.intp)
    leader = int(np.argmax(count))
    free = agree[leader].copy()
    members = [leader]
    for k in np.argsort(-count, kind="stable").tolist():
        if free[k]:
            members.append(k)
            free &= agree[k]
    return np.array(members, np.intp)

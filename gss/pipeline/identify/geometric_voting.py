"""Geometric voting (Kolomenkin 2008, as used in Erlank 2013 §4.3.3 and Algorithm 2).

For each pair of imaged stars, the distance table gives the catalogue pairs of the same separation. Each of the two
catalogue stars gets a vote for both imaged stars. Each imaged star is assigned the catalogue star with the most votes.
In a second round, every pair of imaged stars whose assigned catalogue stars have the measured separation gives a
verification vote. All counts are integers, and in a tie the lower row is used. Therefore the result is the same on any
machine.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.skytables.bank import OnboardCatalogue
from gss.skytables.pairs import DistanceTable, expanded

Rows = NDArray[np.intp]
Mask = NDArray[np.bool_]


@dataclass(frozen=True)
class Ballot:
    """Result of the first round. ``row``: (n,) catalogue row with the most votes for each imaged star, −1 without
    votes; ``votes``: (n,) number of votes of this row; ``hits``: number of table entries read for all pairs."""

    row: Rows
    votes: Rows
    hits: int


@dataclass(frozen=True)
class ImagePairs:
    """All pairs i < j of n imaged stars and their distances."""

    i: Rows
    j: Rows
    distance_rad: Array


def pairs_of(unit_cam: Array) -> ImagePairs:
    """Return all pairs of (n, 3) unit vectors. Uses chords, because eq. 4.3.1's arccosine is inaccurate at small angles."""
    i, j = np.triu_indices(len(unit_cam), 1)
    return ImagePairs(i, j, _angle_rad(unit_cam[i] - unit_cam[j]))


def _angle_rad(chord: Array) -> Array:
    half = 0.5 * np.sqrt(np.einsum("ij,ij->i", chord, chord))
    return np.asarray(2.0 * np.arcsin(np.minimum(half, 1.0)))


def reduced_table(table: DistanceTable, allowed: Mask) -> DistanceTable:
    """Return the pairs whose two stars are both in the reduced catalogue (Erlank 2013 §4.3.4)."""
    keep = np.flatnonzero(allowed[table.first] & allowed[table.second])
    return DistanceTable(table.first[keep], table.second[keep], table.distance_rad[keep], table.min_rad, table.max_rad)


def vote(pairs: ImagePairs, stars: int, table: DistanceTable, rows: int, tolerance_rad: float) -> Ballot:
    """Run the first round for ``stars`` imaged stars and a catalogue of ``rows`` stars, by binary search in the table."""
    pair, entry = expanded(*table.ranges(pairs.distance_rad - tolerance_rad, pairs.distance_rad + tolerance_rad))
    first, second = table.first[entry], table.second[entry]
    i, j = pairs.i[pair] * rows, pairs.j[pair] * rows
    lists = np.bincount(np.concatenate([i + first, i + second, j + first, j + second]), minlength=stars * rows)
    votes = lists.reshape(stars, rows)
    row = np.argmax(votes, axis=1) if rows else np.full(stars, -1)
    max_votes = votes[np.arange(stars), row] if rows else np.zeros(stars, np.intp)
    return Ballot(np.where(max_votes > 0, row, -1), max_votes, len(pair))


def agreement(pairs: ImagePairs, row: Rows, catalogue: OnboardCatalogue, tolerance_rad: float) -> NDArray[np.int64]:
    """Return the (n, n) symmetric 0/1 matrix, 1 if the assigned catalogue stars of two imaged stars have the measured
    separation. Two imaged stars with the same catalogue star never agree."""
    agree = np.zeros((len(row), len(row)), np.int64)
    a, b = row[pairs.i], row[pairs.j]
    voted = np.flatnonzero((a >= 0) & (b >= 0) & (a != b))
    icrs = catalogue.icrs.astype(float)
    apart_rad = _angle_rad(icrs[a[voted]] - icrs[b[voted]])
    ok = voted[np.abs(apart_rad - pairs.distance_rad[voted]) <= tolerance_rad]
    agree[pairs.i[ok], pairs.j[ok]] = agree[pairs.j[ok], pairs.i[ok]] = 1
    return agree


def cluster(verification: NDArray[np.int64], margin: int) -> Rows:
    """Return the stars with verification votes within ``margin`` of the highest count (Kolomenkin; Erlank 2013 §4.3.3 uses one)."""
    max_votes = int(verification.max(initial=0))
    return np.flatnonzero(verification >= max(1, max_votes - margin))


def mutually_consistent(agree: NDArray[np.int64], chosen: Rows) -> Rows:
    """Return a subset of ``chosen`` in which every pair agrees. The star with the most disagreements is removed
    repeatedly.

    This step is not in the document. There, false stars that by chance receive nearly the most votes are used for the
    attitude.
    """
    chosen = chosen.copy()
    while len(chosen) > 1:
        friends = agree[np.ix_(chosen, chosen)].sum(axis=1)
        if friends.min() == len(chosen) - 1:
            break
        # Among stars with equally many disagreements, the star with fewer votes in total is removed. If the votes are
        # also equal, the later and fainter star is removed.
        total = agree[chosen].sum(axis=1)
        worst = np.lexsort((-np.arange(len(chosen)), total, friends))[0]
        chosen = np.delete(chosen, worst)
    return chosen

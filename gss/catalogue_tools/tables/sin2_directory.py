"""The star-pair directory of FAR-MST on the ground: sizes, how straight sin²θ runs, and the table itself (Huffman 2006 §5.5.4).

The processor makes its directory from the bank's distances; this one comes from the stars, so that the two check each other.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.catalogue_tools.tables.distances import distance_table
from gss.catalogue_tools.tables.kvector import KVector, k_vector
from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.domain.stars import StarTable

PAIR_BYTES = 2 * 2 + 4
K_BYTES = 4


@dataclass(frozen=True)
class PairDirectory:
    """Pairs of rows with ascending ``sin2`` and the k-vector over it, whose "radians" are the numbers of sin²θ."""

    first: NDArray[np.int32]
    second: NDArray[np.int32]
    sin2: Array
    k: KVector

    def __len__(self) -> int:
        return len(self.sin2)

    def rows_between(self, low: float, high: float) -> slice:
        """Exactly the pairs with low ≤ sin²θ ≤ high."""
        start, end = self.k.bounds(low, high)
        inside = np.flatnonzero((self.sin2[start:end] >= low) & (self.sin2[start:end] <= high))
        return slice(start + int(inside[0]), start + int(inside[-1]) + 1) if len(inside) else slice(0, 0)


@dataclass(frozen=True)
class DirectoryFigures:
    """``bow_sin2`` and ``bow_cos``: largest distance of the sorted values from the straight line through their ends, as a share
    of the table: what a k-vector look-up has to put right."""

    stars: int
    pairs: int
    size_bytes: int
    bow_sin2: float
    bow_cos: float


def pair_directory(stars: StarTable, max_rad: float) -> PairDirectory:
    """All pairs of ``stars`` less than ``max_rad`` (at most 90°) apart."""
    if not 0 < max_rad <= np.pi / 2:
        raise BadInput(
            "sin²θ does not tell pairs beyond 90° apart", expected="0° to 90°", got=f"{np.degrees(max_rad):g}°"
        )
    table = distance_table(stars, 0.0, max_rad)
    sine = np.sin(np.asarray(table.distance_rad, float))
    sin2 = sine * sine
    return PairDirectory(table.first, table.second, sin2, k_vector(sin2))


def figures(directory: PairDirectory, stars: int) -> DirectoryFigures:
    """What the directory costs and how straight it is."""
    cosine = np.sqrt(1 - directory.sin2)
    return DirectoryFigures(
        stars,
        len(directory),
        len(directory) * (PAIR_BYTES + K_BYTES),
        _bow(directory.sin2),
        _bow(1 - cosine),
    )


def _bow(ascending: Array) -> float:
    share = (ascending - ascending[0]) / (ascending[-1] - ascending[0])
    return float(np.max(np.abs(share - np.linspace(0, 1, len(share)))))

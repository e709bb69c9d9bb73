"""Ground version of FAR-MST's star-pair directory: table, size and linearity of sin²θ (Huffman 2006 §5.5.4).

The processor builds its directory from the distances in the bank; this one is built from the stars, so that each checks
the other.
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
    """Pairs of rows with ascending ``sin2`` and its k-vector, whose ``_rad`` fields are values of sin²θ here."""

    first: NDArray[np.int32]
    second: NDArray[np.int32]
    sin2: Array
    k: KVector

    def __len__(self) -> int:
        return len(self.sin2)

    def rows_between(self, low: float, high: float) -> slice:
        """Return the rows of exactly the pairs with low ≤ sin²θ ≤ high."""
        start, end = self.k.bounds(low, high)
        inside = np.flatnonzero((self.sin2[start:end] >= low) & (self.sin2[start:end] <= high))
        return slice(start + int(inside[0]), start + int(inside[-1]) + 1) if len(inside) else slice(0, 0)


@dataclass(frozen=True)
class DirectoryFigures:
    """``bow_sin2``, ``bow_cos``: largest deviation of the sorted values from the straight line between their ends,
    as a fraction of the table. A k-vector look-up has to correct for this."""

    stars: int
    pairs: int
    size_bytes: int
    bow_sin2: float
    bow_cos: float


def pair_directory(stars: StarTable, max_rad: float) -> PairDirectory:
    """Build the directory of all pairs of ``stars`` at most ``max_rad`` (at most 90°) apart."""
    if not 0 < max_rad <= np.pi / 2:
        raise BadInput(
            "sin²θ does not tell pairs beyond 90° apart", expected="0° to 90°", got=f"{np.degrees(max_rad):g}°"
        )
    table = distance_table(stars, 0.0, max_rad)
    sine = np.sin(np.asarray(table.distance_rad, float))
    sin2 = sine * sine
    return PairDirectory(table.first, table.second, sin2, k_vector(sin2))


def figures(directory: PairDirectory, stars: int) -> DirectoryFigures:
    """Compute size and linearity of the directory."""
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

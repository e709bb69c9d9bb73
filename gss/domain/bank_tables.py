"""Decoded tables that a bank may hold besides its star list and distance table; shared by ground tools and on-board chains.

A chain uses the table it needs if the bank holds it, and otherwise computes it from the stars.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.neighbours import NeighbourLinks
from gss.domain.triplets import Constellations


@dataclass(frozen=True)
class LineIndex:
    """k-vector index of an ascending table: ``k[t]`` is the number of values not above ``start`` + ``step``·t. The
    values are distances in rad, or sin²θ if the bank stores that."""

    k: NDArray[np.int32]
    start: float
    step: float


@dataclass(frozen=True)
class ReducedFrame:
    """Frame size for which a reduced catalogue is made.

    The catalogue keeps the ``brightest`` stars of every upright frame of this size, at pointings ``step_rad`` apart
    (Huffman 2006 §5.5.4: eight, 1°; the document does not specify the frame).
    """

    width_rad: float
    height_rad: float
    brightest: int = 8
    step_rad: float = float(np.radians(1.0))


@dataclass(frozen=True)
class ReducedCatalogue:
    """Subset of a star list. ``kept``: (n,) mask of its stars."""

    kept: NDArray[np.bool_]
    frame: ReducedFrame


@dataclass(frozen=True)
class BankTables:
    """Optional tables of a bank; None if it has no such table.

    ``index``: over the distance table, or over ``sin2``. ``sin2``: (m,) sin²θ of the pairs at the precision stored on
    the device. ``flags``: (n,) the stars' FLAG_ bits.
    """

    index: LineIndex | None = None
    sin2: NDArray[np.floating] | None = None
    reduced: ReducedCatalogue | None = None
    constellations: Constellations | None = None
    links: NeighbourLinks | None = None
    flags: NDArray[np.uint8] | None = None


NO_TABLES = BankTables()

"""What a bank may hold beside its star list and its distance table, decoded: the words that ground and processor share.

A chain that finds its own table here uses it; where it does not, the chain makes one from the stars.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.neighbours import NeighbourLinks
from gss.domain.triplets import Constellations


@dataclass(frozen=True)
class LineIndex:
    """The k-vector of an ascending table: ``k[t]`` of its values are not above ``start`` + ``step``·t. Of distances in rad, or of
    sin²θ where the bank has that."""

    k: NDArray[np.int32]
    start: float
    step: float


@dataclass(frozen=True)
class ReducedFrame:
    """The frame that a reduced catalogue is made for: the ``brightest`` stars of every upright frame of that size, ``step_rad``
    apart (Huffman 2006 §5.5.4: eight, 1°; the document does not say which frame)."""

    width_rad: float
    height_rad: float
    brightest: int = 8
    step_rad: float = float(np.radians(1.0))


@dataclass(frozen=True)
class ReducedCatalogue:
    """``kept``: (n,) which stars of the list belong to it."""

    kept: NDArray[np.bool_]
    frame: ReducedFrame


@dataclass(frozen=True)
class BankTables:
    """None where the bank has no such table. ``index``: over the distance table, or over ``sin2``: (m,) sin²θ of its pairs at the
    width the device stores. ``flags``: (n,) the stars' FLAG_ bits."""

    index: LineIndex | None = None
    sin2: NDArray[np.floating] | None = None
    reduced: ReducedCatalogue | None = None
    constellations: Constellations | None = None
    links: NeighbourLinks | None = None
    flags: NDArray[np.uint8] | None = None


NO_TABLES = BankTables()

"""Decoded content of a flash bank, shared by ground tools and on-board chains.

If the bank does not contain a table that a chain needs, the chain computes the table from the stars.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.errors import BadInput
from gss.domain.stars import Ids
from gss.skytables.kvector import KVector
from gss.skytables.neighbours import NeighbourLinks
from gss.skytables.pairs import DistanceTable
from gss.skytables.triplets import Constellations


@dataclass(frozen=True)
class ReducedFrame:
    """Frame size for which a reduced catalogue is built.

    The catalogue keeps the ``brightest`` stars of every upright frame of this size, at pointings ``step_rad`` apart
    (Huffman 2006 §5.5.4: eight stars, 1°; the document does not specify the frame).
    """

    width_rad: float
    height_rad: float
    brightest: int = 8
    step_rad: float = float(np.radians(1.0))


@dataclass(frozen=True)
class ReducedCatalogue:
    """Subset of a star list. ``kept``: (n,) mask of the stars in the subset."""

    kept: NDArray[np.bool_]
    frame: ReducedFrame


@dataclass(frozen=True)
class BankTables:
    """Optional tables of a bank. A field is None if the bank does not contain the table.

    ``index``: k-vector of the distance table, or of ``sin2``. ``sin2``: (m,) sin²θ of the pairs at the precision stored
    on the device. ``flags``: (n,) the stars' FLAG_ bits.
    """

    index: KVector | None = None
    sin2: NDArray[np.floating] | None = None
    reduced: ReducedCatalogue | None = None
    constellations: Constellations | None = None
    links: NeighbourLinks | None = None
    flags: NDArray[np.uint8] | None = None


NO_TABLES = BankTables()


@dataclass(frozen=True)
class OnboardCatalogue:
    """Decoded content of one flash bank: everything the matcher can use.

    ``hip``: (n,) catalogue numbers by row, which are known only on the ground. For formats that store only row ids, the
    numbers are taken from the manifest. ``icrs``: (n, 3) unit vectors at the precision stored on the device. ``v_mag``:
    (n,), NaN if the format stores no magnitudes. ``distances`` is empty if the format has other tables instead.
    ``tables``: the other tables in the bank.
    """

    hip: Ids
    icrs: NDArray[np.floating]
    v_mag: NDArray[np.floating]
    distances: DistanceTable
    tables: BankTables = NO_TABLES

    def __len__(self) -> int:
        return len(self.hip)

    def need_distances(self) -> None:
        """Raise BadInput if the bank's format has other tables instead of distances."""
        if not len(self.distances) and (self.tables.links is not None or self.tables.constellations is not None):
            raise BadInput(
                "this chain needs a distance table",
                expected="a bank with pairs of stars",
                got="a bank with triplets or links",
                hint="use a catalogue in the format of the chain's own system",
            )

"""Definition of an on-board format, and checks shared by several formats."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.catalogue_tools.formats.blocks import Block, Columns, Rows
from gss.catalogue_tools.formats.header import BankHeader
from gss.domain.errors import BadInput, CorruptData
from gss.domain.stars import StarTable
from gss.skytables.bank import NO_TABLES, BankTables
from gss.skytables.pairs import DistanceTable


@dataclass(frozen=True)
class Content:
    """Decoded content between header and sections.

    ``icrs``: (n, 3) directions at the precision stored on the device. ``tables``: tables contained in the star list or
    the pairs.
    """

    icrs: NDArray[np.floating]
    v_mag: NDArray[np.floating]
    distances: DistanceTable
    tables: BankTables = NO_TABLES


@dataclass(frozen=True)
class BankFormat:
    """Definition of a format: its ``number`` in the header and on the wire, its tables and limits, and the functions
    that write and read its columns.

    ``pairs`` None: no distance table. ``ascending``: function from the decoded columns of the pairs to the values by
    which the pairs are sorted, over which the k-vector is built. ``sections``: tags of the required sections.
    """

    name: str
    number: int
    source: str
    stars: Rows
    pairs: Rows | None
    most_stars: int
    largest_pair_rad: float
    write: Callable[[StarTable, DistanceTable], tuple[Columns, Columns]]
    read: Callable[[Columns, Columns, BankHeader], Content]
    ascending: Callable[[Columns], NDArray[np.floating]] = lambda pairs: pairs["distance_rad"]
    sections: tuple[str, ...] = ()

    def blocks(self, stars: int, pairs: int) -> tuple[Block, ...]:
        """Blocks of star list and pairs, without header and sections."""
        return self.stars.blocks(stars) + (self.pairs.blocks(pairs) if self.pairs else ())

    @property
    def pair_bytes(self) -> int:
        """Bytes per pair; 0 without pairs."""
        return self.pairs.row_bytes if self.pairs else 0


def whole_numbers(name: str, values: NDArray[np.floating], unit: float, low: int, high: int) -> NDArray[np.int64]:
    """Return values as multiples of ``unit``. Raises BadInput if a multiple is outside [low, high]."""
    steps = np.rint(np.asarray(values, float) / unit)
    bad = ~((steps >= low) & (steps <= high))
    if bad.any():
        worst = float(np.asarray(values)[np.argmax(bad)])
        raise BadInput(
            f"{name} does not fit its integer type",
            expected=f"{low * unit:g} to {high * unit:g}",
            got=f"{worst:g}",
        )
    return steps.astype(np.int64)


# Magnitudes are stored in thousandths; the lowest number means unknown.
NO_MAGNITUDE = -(1 << 15)


def to_millimag(v_mag: NDArray[np.floating]) -> NDArray[np.int16]:
    """Convert magnitudes to thousandths as i16."""
    finite = np.isfinite(v_mag)
    steps = whole_numbers("a magnitude", np.where(finite, v_mag, 0.0), 1e-3, NO_MAGNITUDE + 1, -NO_MAGNITUDE - 1)
    return np.where(finite, steps, NO_MAGNITUDE).astype(np.int16)


def from_millimag(steps: NDArray[np.int16]) -> NDArray[np.float32]:
    """Return magnitudes, NaN if unknown."""
    return np.where(steps == NO_MAGNITUDE, np.nan, steps.astype(float) * 1e-3).astype(np.float32)


def check_range(name: str, values: NDArray[np.floating], low: float, high: float) -> None:
    """Raise CorruptData if a stored number is not finite or out of range."""
    if not np.all((values >= low) & (values <= high)):
        worst = values[np.argmax(~((values >= low) & (values <= high)))]
        raise CorruptData(f"{name} is impossible", expected=f"{low:g} to {high:g}", got=f"{worst:g}")

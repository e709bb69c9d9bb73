"""Flash memory: programming can only clear bits, erasing sets whole sectors."""

from __future__ import annotations

import mmap
from typing import Any

import numpy as np

SECTOR_BYTES = 4096


class FlashError(Exception):
    """Raised when data would set a bit from 0 to 1 without erasing its sector, or when programming fails."""


class Flash:
    """Flash cells: programming can only clear bits.

    ``cells``: a bytearray, or a memory-mapped file. ``fail_next``: if True, the next programming operation fails after
    half of its bytes.
    """

    def __init__(self, cells: bytearray | mmap.mmap) -> None:
        self._cells: Any = cells
        self.fail_next = False

    def __len__(self) -> int:
        return len(self._cells)

    def read(self, offset: int, count: int) -> bytes:
        """Return the stored bytes."""
        return bytes(self._cells[offset : offset + count])

    def erase(self, offset: int, count: int) -> None:
        """Set all sectors that overlap the range to FF."""
        first = offset // SECTOR_BYTES * SECTOR_BYTES
        last = -(-(offset + count) // SECTOR_BYTES) * SECTOR_BYTES
        self._cells[first:last] = b"\xff" * (last - first)

    def program(self, offset: int, data: bytes) -> None:
        """Clear bits. Writing the same data twice has no effect. Raises FlashError if the data would set a bit."""
        if self.fail_next:
            self.fail_next = False
            half = data[: len(data) // 2]
            self._cells[offset : offset + len(half)] = half
            raise FlashError(f"programming of sector {offset // SECTOR_BYTES} failed")
        old = np.frombuffer(self.read(offset, len(data)), np.uint8)
        new = old & np.frombuffer(data, np.uint8)
        self._cells[offset : offset + len(data)] = new.tobytes()
        if new.tobytes() != data:
            raise FlashError(f"flash at {offset} was not erased")

    def flip(self, offset: int, bit: int = 0) -> None:
        """Flip one bit (radiation)."""
        self._cells[offset] = self._cells[offset] ^ (1 << bit)

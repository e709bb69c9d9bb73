"""A flash memory: bytes that programming can only clear, and sectors that erasing sets."""

from __future__ import annotations

import mmap
from typing import Any

import numpy as np

SECTOR_BYTES = 4096


class FlashError(Exception):
    """A cell was to be set from 0 to 1 without erasing its sector, or the chip failed."""


class Flash:
    """Bytes whose bits programming can only clear. ``cells`` is a bytearray, or a file mapped into memory. ``fail_next``: the
    next programming leaves half of its bytes unwritten."""

    def __init__(self, cells: bytearray | mmap.mmap) -> None:
        self._cells: Any = cells
        self.fail_next = False

    def __len__(self) -> int:
        return len(self._cells)

    def read(self, offset: int, count: int) -> bytes:
        """Bytes as they are."""
        return bytes(self._cells[offset : offset + count])

    def erase(self, offset: int, count: int) -> None:
        """All sectors that the range touches become FF."""
        first = offset // SECTOR_BYTES * SECTOR_BYTES
        last = -(-(offset + count) // SECTOR_BYTES) * SECTOR_BYTES
        self._cells[first:last] = b"\xff" * (last - first)

    def program(self, offset: int, data: bytes) -> None:
        """Clear bits; writing the same data twice is harmless, other data over old is a FlashError."""
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
        """Radiation: one bit changes."""
        self._cells[offset] = self._cells[offset] ^ (1 << bit)

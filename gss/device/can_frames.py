"""CAN frames as records of 16 bytes. Drivers, captures and replays can thus handle a CAN bus like any other line.

A record consists of the LINKTYPE_CAN_SOCKETCAN header (identifier with its flags, big-endian; length; three zero bytes)
and eight bytes of data, padded with zeros. Pure.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass

RECORD = struct.Struct(">IB3x8s")
EXTENDED, REMOTE, ERROR = 1 << 31, 1 << 30, 1 << 29
MAX_STANDARD, MAX_EXTENDED = 0x7FF, 0x1FFF_FFFF
MAX_DATA = 8


@dataclass(frozen=True)
class CanFrame:
    """One classic CAN frame. ``data``: at most eight bytes."""

    id: int
    data: bytes = b""
    extended: bool = False
    remote: bool = False

    def record(self) -> bytes:
        """Return the frame as 16 bytes."""
        flags = EXTENDED * self.extended | REMOTE * self.remote
        return RECORD.pack(self.id | flags, len(self.data), self.data)


class CanReader:
    """Reads records from a byte stream and drops, byte by byte, data that cannot be a record. Error frames are counted
    and dropped."""

    def __init__(self) -> None:
        self._buffer = b""
        self.bytes = self.unframed = self.errors = 0

    def restart(self) -> None:
        """Discard the partial record. The counters do not change."""
        self._buffer = b""

    def feed(self, data: bytes) -> list[CanFrame]:
        """Return the frames that ``data`` completes."""
        self.bytes += len(data)
        buffer, at, frames = self._buffer + data, 0, []
        while len(buffer) - at >= RECORD.size:
            record = buffer[at : at + RECORD.size]
            if not _is_record(record):
                at += 1
                self.unframed += 1
                continue
            at += RECORD.size
            flagged, length, content = RECORD.unpack(record)
            if flagged & ERROR:
                self.errors += 1
                continue
            frames.append(
                CanFrame(flagged & MAX_EXTENDED, content[:length], bool(flagged & EXTENDED), bool(flagged & REMOTE))
            )
        self._buffer = buffer[at:]
        return frames


def _is_record(record: bytes) -> bool:
    """True if the identifier, length and padding are valid."""
    flagged, length, content = RECORD.unpack(record)
    if length > MAX_DATA or any(record[5:8]) or any(content[length:]):
        return False
    return bool(flagged & (EXTENDED | ERROR)) or flagged & MAX_EXTENDED <= MAX_STANDARD

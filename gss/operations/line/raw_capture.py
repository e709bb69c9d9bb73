"""Raw capture: every byte of a contact, in both directions, written before it is processed.

A file is a sequence of records: f64 Unix seconds, u8 direction (0 received, 1 sent), u32 length, then the bytes; little endian.
A contact's capture is one or more files, ``contact-000012-000.raw`` and so on; a record is never split over two files.
Files that are no longer written are compressed (:mod:`capture_files`).
"""

from __future__ import annotations

import contextlib
import os
import struct
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

from gss.operations.line.capture_files import PackedReader, open_capture, plain_blocks, plain_name, position

RECORD = struct.Struct("<dBI")
RECEIVED, SENT = 0, 1
MAX_RECORD_LENGTH = 1 << 24
"""Far longer than any read or write of the line; a longer record means that the file is damaged."""
Record = tuple[float, int, bytes]
"""(Unix seconds, direction, bytes)."""


@dataclass(frozen=True)
class Retention:
    """Limits: a new file is started at ``file_bytes``; the oldest files are removed when the total exceeds ``keep_bytes``."""

    file_bytes: int = 64 << 20
    keep_bytes: int = 1 << 30


def capture_name(contact_id: int) -> str:
    """Return the prefix of the names of a contact's files."""
    return f"contact-{contact_id:06d}"


def read_capture(file: BinaryIO | PackedReader) -> Iterator[Record]:
    """Yield each complete record of a file. Ends without an error at a truncated or invalid record, as a crash leaves one."""
    while len(head := file.read(RECORD.size)) == RECORD.size:
        unix_s, direction, length = RECORD.unpack(head)
        if direction not in (RECEIVED, SENT) or length > MAX_RECORD_LENGTH:
            return
        data = file.read(length)
        if len(data) < length:
            return
        yield unix_s, direction, data


def read_captures(paths: Iterable[Path], unread: Callable[[Path, int], None] | None = None) -> Iterator[Record]:
    """Yield the records of several files in order; a truncated file does not hide the next one. ``unread``: called with each
    file whose end could not be read and the number of bytes skipped, on the disk if it is a damaged compressed file."""
    for path in paths:
        with open_capture(path) as file:
            whole = 0
            try:
                for record in read_capture(file):
                    whole = position(file)
                    yield record
                # In a file that is still being written the last complete record ends at the read position; in a damaged
                # one it does not.
                torn = position(file) != whole
                skipped = _rest(file) - whole if torn else 0
            except OSError:
                skipped = path.stat().st_size
            if unread is not None and skipped:
                unread(path.with_name(plain_name(path)), skipped)


def _rest(file: BinaryIO | PackedReader) -> int:
    """Read to the end of a file and return its length in plain bytes."""
    while file.read(1 << 20):
        pass
    return position(file)


def read_received(paths: Iterable[Path]) -> Iterator[Record]:
    """Yield files of plain received bytes as records at the time 0."""
    for path in paths:
        for data in plain_blocks(path, 1 << 16):
            yield 0.0, RECEIVED, data


def capture_span(paths: Iterable[Path]) -> tuple[float, float] | None:
    """Return Unix seconds of the first and last record, read from the record headers alone; None without records."""
    first: float | None = None
    last = 0.0
    for path in paths:
        with open_capture(path) as file, contextlib.suppress(OSError):  # a damaged compressed file ends early
            for unix_s in _times(file):
                first, last = (unix_s if first is None else first), unix_s
    return None if first is None else (first, last)


def _times(file: BinaryIO | PackedReader) -> Iterator[float]:
    """Yield the time of each complete record."""
    while len(head := file.read(RECORD.size)) == RECORD.size:
        unix_s, direction, length = RECORD.unpack(head)
        if direction not in (RECEIVED, SENT) or length > MAX_RECORD_LENGTH:
            return
        end = position(file) + length
        if isinstance(file, PackedReader):
            file.skip(length)
        elif os.fstat(file.fileno()).st_size >= end:
            file.seek(end)
        if position(file) < end:
            return
        yield unix_s

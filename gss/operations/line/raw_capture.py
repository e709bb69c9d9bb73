"""Raw capture: all bytes of a contact in both directions, written before they are processed.

A file is a sequence of records: f64 Unix seconds, u8 direction (0 received, 1 sent), u32 length, then the bytes. Numbers are
little endian. The capture of a contact consists of one or more files, ``contact-000012-000.raw`` and so on. A record is never
split over two files. Files that are no longer written are compressed (:mod:`capture_files`).
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
"""Maximum length of a record. Reads and writes of the line are much shorter, so a longer record means a damaged file."""
Record = tuple[float, int, bytes]
"""(Unix seconds, direction, bytes)."""


@dataclass(frozen=True)
class Retention:
    """Size limits. ``file_bytes``: size at which a new file is started. ``keep_bytes``: total size above which the oldest files
    are removed."""

    file_bytes: int = 64 << 20
    keep_bytes: int = 1 << 30


def capture_name(contact_id: int) -> str:
    """Return the prefix of the names of a contact's files."""
    return f"contact-{contact_id:06d}"


def read_capture(file: BinaryIO | PackedReader) -> Iterator[Record]:
    """Yield the records of a file. Stop without an error at the first truncated or invalid record, which a crash can
    cause."""
    while len(head := file.read(RECORD.size)) == RECORD.size:
        unix_s, direction, length = RECORD.unpack(head)
        if direction not in (RECEIVED, SENT) or length > MAX_RECORD_LENGTH:
            return
        data = file.read(length)
        if len(data) < length:
            return
        yield unix_s, direction, data


def read_captures(paths: Iterable[Path], unread: Callable[[Path, int], None] | None = None) -> Iterator[Record]:
    """Yield the records of several files in order. After a truncated file, the next file is read. ``unread``: called
    with each file whose end could not be read and the number of skipped bytes. For a damaged compressed file, this
    number is the size of the file on disk."""
    for path in paths:
        with open_capture(path) as file:
            complete_end = 0
            try:
                for record in read_capture(file):
                    complete_end = position(file)
                    yield record
                # In an undamaged file, the last complete record ends at the read position.
                truncated = position(file) != complete_end
                skipped = _plain_length(file) - complete_end if truncated else 0
            except OSError:
                skipped = path.stat().st_size
            if unread is not None and skipped:
                unread(path.with_name(plain_name(path)), skipped)


def _plain_length(file: BinaryIO | PackedReader) -> int:
    """Read to the end of a file and return its length in plain bytes."""
    while file.read(1 << 20):
        pass
    return position(file)


def read_received(paths: Iterable[Path]) -> Iterator[Record]:
    """Yield the content of files of received bytes as records with time 0."""
    for path in paths:
        for data in plain_blocks(path, 1 << 16):
            yield 0.0, RECEIVED, data


def capture_span(paths: Iterable[Path]) -> tuple[float, float] | None:
    """Return the times of the first and last record in Unix seconds, None without records. Only record headers are read."""
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

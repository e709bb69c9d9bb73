"""Raw capture: every byte of a contact, in both directions, written before it is processed.

A file is a sequence of records: f64 Unix seconds, u8 direction (0 received, 1 sent), u32 length, then the bytes; little endian.
A contact's capture is one or more files, ``contact-000012-000.raw`` and so on; a record is never split over two files.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from io import FileIO
from pathlib import Path
from typing import BinaryIO

RECORD = struct.Struct("<dBI")
RECEIVED, SENT = 0, 1
LONGEST_RECORD = 1 << 24
"""Far longer than any read or write of the line; a longer record means that the file is damaged."""
NAME = re.compile(r"contact-(\d+)-(\d+)\.raw")
Record = tuple[float, int, bytes]
"""(Unix seconds, direction, bytes)."""


@dataclass(frozen=True)
class Retention:
    """Limits: a new file is started at ``file_bytes``; the oldest files are removed when the total exceeds ``keep_bytes``."""

    file_bytes: int = 64 << 20
    keep_bytes: int = 1 << 30


class RawCapture:
    """Rotating capture of one contact in ``folder``. Existing files are never overwritten."""

    def __init__(self, folder: Path, contact_id: int, retention: Retention | None = None) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._folder, self._contact_id = folder, contact_id
        self._retention = retention or Retention()
        self._sizes: dict[str, int] = {}
        self._part = -1
        self._file, self._size = self._next(), 0

    @property
    def name(self) -> str:
        """Prefix of the names of this contact's files."""
        return capture_name(self._contact_id)

    @property
    def files(self) -> list[dict[str, object]]:
        """Name and size of each file that was written, including files that were removed since."""
        return [{"file": name, "bytes": size} for name, size in list(self._sizes.items())]

    def write(self, unix_s: float, direction: int, data: bytes) -> None:
        """Append one record, unbuffered: the operating system has it when this returns. Raises OSError if it cannot be
        written (disk full); then no part of it is in the file, and the next record can be tried."""
        if not data:
            return
        if self._size >= self._retention.file_bytes:
            following = self._next()
            self._file.close()
            self._file, self._size = following, 0
            self._drop_oldest()
        record = RECORD.pack(unix_s, direction, len(data)) + data
        try:
            done = 0
            while done < len(record):
                done += self._file.write(memoryview(record)[done:])
        except OSError:
            self._file.truncate(self._size)
            self._file.seek(self._size)
            raise
        self._size += len(record)
        self._sizes[Path(self._file.name).name] = self._size

    def keep_at_most(self, keep_bytes: int) -> None:
        """Set the total size beyond which the oldest files are removed."""
        self._retention = replace(self._retention, keep_bytes=keep_bytes)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _next(self) -> FileIO:
        """Create the next file. A recreated database numbers its contacts from 1 again, so existing files are skipped."""
        while True:
            self._part += 1
            path = self._folder / f"{self.name}-{self._part:03d}.raw"
            try:
                file = path.open("xb", buffering=0)
            except FileExistsError:
                continue
            self._sizes[path.name] = 0
            return file

    def _drop_oldest(self) -> None:
        files = capture_files(self._folder)
        total = sum(p.stat().st_size for p in files)
        for path in files:
            if total <= self._retention.keep_bytes or path.name == Path(self._file.name).name:
                break
            total -= path.stat().st_size
            path.unlink()


def capture_name(contact_id: int) -> str:
    """Return the prefix of the names of a contact's files."""
    return f"contact-{contact_id:06d}"


def capture_files(folder: Path, contact_id: int | None = None) -> list[Path]:
    """Return the files of a contact (None: of all) in the order in which they were written."""
    found = [(NAME.fullmatch(p.name), p) for p in folder.glob("contact-*.raw")]
    numbered = [(int(m[1]), int(m[2]), p) for m, p in found if m and contact_id in (None, int(m[1]))]
    return [p for _, _, p in sorted(numbered)]


def read_capture(file: BinaryIO) -> Iterator[Record]:
    """Yield each complete record of a file. Ends without an error at a truncated or invalid record, as a crash leaves one."""
    while len(head := file.read(RECORD.size)) == RECORD.size:
        unix_s, direction, length = RECORD.unpack(head)
        if direction not in (RECEIVED, SENT) or length > LONGEST_RECORD:
            return
        data = file.read(length)
        if len(data) < length:
            return
        yield unix_s, direction, data


def read_captures(
    paths: Iterable[Path], unread: Callable[[Path, int], None] = lambda _path, _bytes: None
) -> Iterator[Record]:
    """Yield the records of several files in order; a truncated file does not hide the next one. ``unread``: called with each
    file whose end could not be read and the number of bytes skipped."""
    for path in paths:
        with path.open("rb") as file:
            whole = 0
            for record in read_capture(file):
                whole = file.tell()
                yield record
            # In a file that is still being written the last complete record ends at the read position; in a damaged one
            # it does not.
            if file.tell() != whole:
                unread(path, path.stat().st_size - whole)


def capture_span(paths: Iterable[Path]) -> tuple[float, float] | None:
    """Return Unix seconds of the first and last record, read from the record headers alone; None without records."""
    first: float | None = None
    last = 0.0
    for path in paths:
        size = path.stat().st_size
        with path.open("rb") as file:
            while len(head := file.read(RECORD.size)) == RECORD.size:
                unix_s, direction, length = RECORD.unpack(head)
                if direction not in (RECEIVED, SENT) or length > LONGEST_RECORD or file.tell() + length > size:
                    break
                file.seek(length, 1)
                first, last = (unix_s if first is None else first), unix_s
    return None if first is None else (first, last)

"""Every byte of a contact, in both directions, written before anything looks at it.

A file is a run of records: f64 Unix seconds, u8 direction (0 received, 1 sent), u32 length, then the bytes; little endian.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from pathlib import Path
from typing import BinaryIO

RECORD = struct.Struct("<dBI")
RECEIVED, SENT = 0, 1
FILE_BYTES = 64 << 20
KEEP_BYTES = 1 << 30


class RawCapture:
    """Rotating capture of one contact in ``folder``; the oldest files of any contact go when all together pass the limit."""

    def __init__(self, folder: Path, contact_id: int) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._folder, self._contact_id, self._part = folder, contact_id, 0
        self._file: BinaryIO = self._open()

    @property
    def name(self) -> str:
        """What the files of this contact begin with."""
        return f"contact-{self._contact_id:06d}"

    def write(self, unix_s: float, direction: int, data: bytes) -> None:
        """Append one record; it is in the operating system's hands when this returns."""
        if not data:
            return
        if self._file.tell() > FILE_BYTES:
            self._file.close()
            self._part += 1
            self._file = self._open()
            self._drop_oldest()
        self._file.write(RECORD.pack(unix_s, direction, len(data)) + data)
        self._file.flush()

    def close(self) -> None:
        """End the file."""
        self._file.close()

    def _open(self) -> BinaryIO:
        return (self._folder / f"{self.name}-{self._part:03d}.raw").open("wb")

    def _drop_oldest(self) -> None:
        files = sorted(self._folder.glob("contact-*.raw"))  # names ascend with time
        total = sum(p.stat().st_size for p in files)
        for path in files[:-1]:
            if total <= KEEP_BYTES:
                break
            total -= path.stat().st_size
            path.unlink()


def read_capture(file: BinaryIO) -> Iterator[tuple[float, int, bytes]]:
    """(unix_s, direction, bytes) of each whole record; a cut-off last record ends the run quietly."""
    while len(head := file.read(RECORD.size)) == RECORD.size:
        unix_s, direction, length = RECORD.unpack(head)
        data = file.read(length)
        if len(data) < length:
            return
        yield unix_s, direction, data

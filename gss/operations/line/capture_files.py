"""Files of raw captures on disk: names, sizes and content, plain or compressed.

A file that is no longer written is compressed: ``contact-000012-000.raw`` becomes ``contact-000012-000.raw.zst``, which the
program ``zstd`` can also read. All code outside this module uses the name without ``.zst``.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import BinaryIO, NamedTuple, Self

NAME = re.compile(r"contact-(\d+)-(\d+)\.raw(?:\.zst)?")
PACKED = ".zst"
SKIP_BYTES = 1 << 20


class SizedFile(NamedTuple):
    """A file of a capture and its size on disk."""

    path: Path
    bytes: int


def capture_files(folder: Path, contact_id: int | None = None) -> list[Path]:
    """Return the files of a contact, or of all contacts if ``contact_id`` is None, in the order in which they were written."""
    name_matches = [(NAME.fullmatch(p.name), p) for p in folder.glob("contact-*.raw*")]
    numbered = sorted((int(m[1]), int(m[2]), p) for m, p in name_matches if m and contact_id in (None, int(m[1])))
    # Both forms exist if the program stopped after the compressed file was complete and before the plain file was
    # removed. The compressed form sorts last, so it replaces the plain form here.
    return list({plain_name(p): p for _, _, p in numbered}.values())


def capture_sizes(folder: Path, contact_id: int | None = None) -> list[SizedFile]:
    """Return the files with their sizes on disk. Files that are removed or compressed during the call are omitted."""
    sizes = []
    for path in capture_files(folder, contact_id):
        with contextlib.suppress(FileNotFoundError):
            sizes.append(SizedFile(path, path.stat().st_size))
    return sizes


def plain_name(path: Path) -> str:
    """Return the name of the file in its plain form."""
    return path.name.removesuffix(PACKED)


def packed_path(path: Path) -> Path:
    """Return the path of the file in its compressed form."""
    return path if path.suffix == PACKED else path.with_name(path.name + PACKED)


class PackedReader:
    """Reader of a compressed capture, with the interface of a file. Reads raise OSError if the file is damaged. ``at``: current
    position in plain bytes."""

    def __init__(self, path: Path) -> None:
        import pyarrow as pa  # imported here because it takes 0.1 s, and few commands read captures

        self._file = pa.OSFile(str(path))
        self._stream, self.at = pa.CompressedInputStream(self._file, "zstd"), 0

    def read(self, size: int = -1) -> bytes:
        """Return ``size`` bytes, fewer only at the end of the file. If ``size`` is negative, return all remaining bytes."""
        data = bytes(self._stream.read() if size < 0 else self._stream.read(size))
        self.at += len(data)
        return data

    def skip(self, size: int) -> None:
        """Skip ``size`` plain bytes."""
        while size > 0 and (data := self.read(min(size, SKIP_BYTES))):
            size -= len(data)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._stream.close()
        self._file.close()


def open_capture(path: Path) -> BinaryIO | PackedReader:
    """Open a file of a capture, plain or compressed, even if it was compressed after its name was read. Raises
    FileNotFoundError if the file was removed or the compressed file cannot be opened."""
    if path.suffix != PACKED:
        try:
            return path.open("rb")
        except FileNotFoundError:
            if not packed_path(path).is_file():
                raise
    try:
        return PackedReader(packed_path(path))
    except FileNotFoundError:
        raise
    except OSError as error:
        raise FileNotFoundError(str(path)) from error


def position(file: BinaryIO | PackedReader) -> int:
    """Return the position in an open file, in plain bytes."""
    return file.at if isinstance(file, PackedReader) else file.tell()


def plain_blocks(path: Path, size: int) -> Iterator[bytes]:
    """Yield the plain bytes of a capture file in blocks of ``size`` bytes."""
    with open_capture(path) as file:
        while data := file.read(size):
            yield data

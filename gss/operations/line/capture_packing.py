"""Compression of raw capture files that are no longer written, in small steps between other work."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator
from pathlib import Path

from gss.operations.clock import Monotonic
from gss.operations.line.capture_files import capture_sizes, packed_path
from gss.operations.line.line_capture import LineCapture
from gss.store.compression import zstd, zstd_plain
from gss.store.durable import sync_path

STEP_BYTES = 1 << 20
"""Plain bytes compressed per step. A step takes about 5 ms."""
LOOK_EVERY_S = 2.0
RETRY_S = 600.0
"""Pause after a disk error. The error is not reported here, because the capture and the store report disk errors."""


class CapturePacking:
    """Compresses files one after another, oldest first. The dispatcher calls it between batches of events.

    Each step writes one zstd frame and verifies it. The plain file is removed after the complete compressed file was flushed to
    the disk. If the program stops during compression, the file is compressed again from its beginning.
    """

    def __init__(self, capture: LineCapture, monotonic_s: Monotonic) -> None:
        self._capture, self._monotonic_s = capture, monotonic_s
        self._steps: Iterator[None] | None = None
        self._look_at_s = monotonic_s()

    def __call__(self) -> None:
        """Compress one step of a file, if there is a file to compress."""
        if self._steps is None:
            now_s = self._monotonic_s()
            if now_s < self._look_at_s:
                return
            self._look_at_s = now_s + LOOK_EVERY_S
            path = next(self._closed(), None)
            if path is None:
                return
            self._steps = _packing(path)
        try:
            if next(self._steps, True) is True:
                self._steps, self._look_at_s = None, self._monotonic_s()
        except OSError:
            self._steps, self._look_at_s = None, self._monotonic_s() + RETRY_S

    def _closed(self) -> Iterator[Path]:
        """Yield the plain files that are no longer written. Empty files are omitted, because they can be new."""
        sized = [file for file in capture_sizes(self._capture.folder) if file.bytes and file.path.suffix == ".raw"]
        # Read after the folder was listed, so a file created meanwhile is not in the list.
        written = self._capture.written_path
        yield from (path for path, _ in sized if path != written)


def _packing(path: Path) -> Iterator[None]:
    """Compress a file and yield after each step. Raises OSError if the compressed file cannot be written; the plain file then
    remains."""
    target = packed_path(path)
    draft = target.with_name(target.name + ".part")
    try:
        with path.open("rb") as plain, draft.open("wb") as out:
            while data := plain.read(STEP_BYTES):
                frame = zstd(data)
                if zstd_plain(frame, len(data)) != data:
                    raise OSError(f"the compressed data of {path.name} are not equal to the original")
                out.write(frame)
                yield None
        sync_path(draft)
        with contextlib.suppress(FileNotFoundError):  # retention can have removed the plain file
            times = path.stat()
            os.utime(draft, ns=(times.st_atime_ns, times.st_mtime_ns))
            draft.rename(target)
            sync_path(path.parent)
            path.unlink()
    finally:
        with contextlib.suppress(FileNotFoundError):
            draft.unlink()

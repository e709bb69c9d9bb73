"""Compresses the files of raw captures that are no longer written, in small steps between other work."""

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
"""Plain bytes of a step, which takes about 5 ms."""
LOOK_EVERY_S = 2.0
RETRY_S = 600.0
"""Pause after a disk error; what is wrong with the disk is reported by those who must write to it."""


class CapturePacking:
    """Compresses one file after another, oldest first, when called between batches of events.

    Each step writes one zstd frame and reads it back; the plain file is removed when the compressed one is whole and on the
    disk. A stop of the program loses a started file, which is begun again.
    """

    def __init__(self, capture: LineCapture, monotonic_s: Monotonic) -> None:
        self._capture, self._monotonic_s = capture, monotonic_s
        self._steps: Iterator[None] | None = None
        self._look_at_s = monotonic_s()

    def __call__(self) -> None:
        """Do one step, if there is anything to compress."""
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
        """Yield the plain files that are no longer written. An empty file may be about to be."""
        sized = [file for file in capture_sizes(self._capture.folder) if file.bytes and file.path.suffix == ".raw"]
        written = self._capture.written_path  # read after the files: one that follows it now is not among them
        yield from (path for path, _ in sized if path != written)


def _packing(path: Path) -> Iterator[None]:
    """Compress a file, yielding after each step. OSError if the disk does not take it; then the plain file is kept."""
    target = packed_path(path)
    draft = target.with_name(target.name + ".part")
    try:
        with path.open("rb") as plain, draft.open("wb") as out:
            while data := plain.read(STEP_BYTES):
                frame = zstd(data)
                if zstd_plain(frame, len(data)) != data:
                    raise OSError(f"{path.name} does not read back")
                out.write(frame)
                yield None
        sync_path(draft)
        with contextlib.suppress(FileNotFoundError):  # retention may have removed it
            times = path.stat()
            os.utime(draft, ns=(times.st_atime_ns, times.st_mtime_ns))
            draft.rename(target)
            sync_path(path.parent)
            path.unlink()
    finally:
        with contextlib.suppress(FileNotFoundError):
            draft.unlink()

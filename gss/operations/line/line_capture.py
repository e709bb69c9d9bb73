"""Raw captures of successive contacts. A full disk does not end a contact; lost bytes are counted and reported."""

from __future__ import annotations

import contextlib
import logging
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import replace
from io import FileIO
from pathlib import Path

from gss.operations.clock import Monotonic, Now
from gss.operations.line.capture_files import capture_sizes, packed_path
from gss.operations.line.raw_capture import RECORD, Retention, capture_name
from gss.store.durable import sync_path

log = logging.getLogger("gss.link")
REMEMBERED = 8
"""Number of latest contacts whose lists of capture files are kept in memory."""
SYNC_EVERY_S = 1.0
"""Interval of flushes to the disk. A power failure loses at most the bytes since the last flush."""


class LineCapture:
    """Writes the bytes of the line to files in ``folder``. ``report``: called with a text when writing fails and when it works
    again; it must not block."""

    def __init__(self, folder: Path, retention: Retention, now: Now, report: Callable[[str], None]) -> None:
        self.folder, self.retention = folder, retention
        self._now, self._report = now, report
        self._capture: RawCapture | None = None
        self._captures: OrderedDict[int, RawCapture] = OrderedDict()
        self.lost_bytes = 0
        """Number of bytes that could not be written to the capture since the server started."""
        self.fails = ""
        """Reason why the capture cannot be written at present, "" if it can."""
        self._lost_from = 0
        self._contact_id = 0

    def begin(self, contact_id: int) -> str:
        """Start the capture of a contact and return the prefix of its file names. A contact that continues gets a further file.
        If the file cannot be created, ``write`` retries."""
        self._capture, self._contact_id = None, contact_id
        try:
            self._open()
        except OSError as error:
            self._failed(error, 0)
        return capture_name(contact_id)

    def _open(self) -> RawCapture:
        if self._capture is None and (capture := self._captures.get(self._contact_id)):
            capture.resume()
            self._capture = capture
        elif self._capture is None:
            self._capture = RawCapture(self.folder, self._contact_id, self.retention)
            self._captures[self._contact_id] = self._capture
            while len(self._captures) > REMEMBERED:
                self._captures.popitem(last=False)
        return self._capture

    def write(self, direction: int, data: bytes) -> None:
        """Write bytes of the line. Call this before the bytes are processed. After a failure, each later call retries."""
        if not data:
            return
        try:
            self._open().write(self._now().timestamp(), direction, data)
        except OSError as error:
            self._failed(error, len(data))
        else:
            if self.fails:
                self.fails = ""
                lost = self.lost_bytes - self._lost_from
                self._report(f"the raw capture continues; {lost} bytes are missing from it")

    def _failed(self, error: OSError, lost_bytes: int) -> None:
        if not self.fails:
            self._lost_from = self.lost_bytes
            self._report(f"the raw capture cannot be written; data from now on is missing: {error}")
        self.fails = str(error)
        self.lost_bytes += lost_bytes

    def files_of(self, contact_id: int) -> list[dict[str, object]] | None:
        """Return name and size of each capture file of a recent contact, None if the contact is not recent or has no file."""
        capture = self._captures.get(contact_id)
        return capture.files if capture else None

    @property
    def written_path(self) -> Path | None:
        """Path of the file that is being written, None if there is none."""
        capture = self._capture
        return None if capture is None else capture.path

    def end(self) -> None:
        """Close the capture of the contact."""
        if self._capture:
            self._capture.close()

    def sync(self) -> None:
        """Flush the bytes written since the last call to the disk. Call this in a thread that the line does not wait for."""
        for capture in list(self._captures.values()):
            capture.sync()

    def keep_at_most(self, keep_bytes: int) -> None:
        """Set the total size of all captures above which the oldest files are removed, and remove them."""
        self.retention = replace(self.retention, keep_bytes=keep_bytes)
        for capture in list(self._captures.values()):  # a contact that continues uses its capture again
            capture.keep_at_most(keep_bytes)
        remove_oldest(self.folder, keep_bytes, self.written_path)


class CaptureSync:
    """Flushes the captures to the disk every ``SYNC_EVERY_S``. The dispatcher calls it between batches of events."""

    def __init__(self, capture: LineCapture, monotonic_s: Monotonic) -> None:
        self._capture, self._monotonic_s = capture, monotonic_s
        self._last_s = monotonic_s()

    def __call__(self) -> None:
        """Flush if ``SYNC_EVERY_S`` has passed. Raises OSError if the disk fails; a later call retries."""
        now_s = self._monotonic_s()
        if now_s - self._last_s >= SYNC_EVERY_S:
            self._last_s = now_s
            self._capture.sync()


class RawCapture:
    """Rotating capture of one contact in ``folder``. Existing files are never overwritten."""

    def __init__(self, folder: Path, contact_id: int, retention: Retention | None = None) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self._folder, self._contact_id = folder, contact_id
        self._retention = retention or Retention()
        self._sizes: dict[str, int] = {}
        self._unsynced: set[Path] = set()
        self._part = -1
        self.resume()

    @property
    def name(self) -> str:
        """Prefix of the names of this contact's files."""
        return capture_name(self._contact_id)

    @property
    def path(self) -> Path | None:
        """Path of the file that is being written, None after the capture was closed."""
        return None if self._file.closed else Path(self._file.name)

    @property
    def files(self) -> list[dict[str, object]]:
        """Name and size of each written file, including files that retention has removed."""
        return [{"file": name, "bytes": size} for name, size in list(self._sizes.items())]

    def write(self, unix_s: float, direction: int, data: bytes) -> None:
        """Append one record, unbuffered: the record has been passed to the operating system when the call returns.
        Raises OSError if it cannot be written (disk full). In this case no part of the record is in the file, and the
        next record can be written."""
        if not data:
            return
        if self._size >= self._retention.file_bytes:
            next_file = self._next()
            self._file.close()
            self._begin_file(next_file)
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
        path = Path(self._file.name)
        self._sizes[path.name] = self._size
        self._unsynced.add(path)

    def sync(self) -> None:
        """Flush the files that were written since the last call, and their directory entries, to the disk. Raises OSError if the
        disk fails; the next call then flushes them again."""
        waiting = list(self._unsynced)
        # Remove the paths before the flush, so that the next call flushes bytes written during this flush.
        self._unsynced.difference_update(waiting)
        try:
            for path in waiting:
                with contextlib.suppress(FileNotFoundError):  # removed by retention
                    sync_path(path)
            if waiting:
                sync_path(self._folder)
        except OSError:
            self._unsynced.update(waiting)
            raise

    def keep_at_most(self, keep_bytes: int) -> None:
        """Set the total size of all captures above which a new file removes the oldest files."""
        self._retention = replace(self._retention, keep_bytes=keep_bytes)

    def resume(self) -> None:
        """Continue in a new file. Raises OSError if it cannot be created."""
        self._begin_file(self._next())

    def _begin_file(self, file: FileIO) -> None:
        self._file, self._size = file, 0
        remove_oldest(self._folder, self._retention.keep_bytes, self.path)

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _next(self) -> FileIO:
        """Create the next file. Existing files are skipped, because a recreated database numbers its contacts from 1 again."""
        while True:
            self._part += 1
            path = self._folder / f"{self.name}-{self._part:03d}.raw"
            if packed_path(path).exists():
                continue
            try:
                file = path.open("xb", buffering=0)
            except FileExistsError:
                continue
            self._sizes[path.name] = 0
            return file


def remove_oldest(folder: Path, keep_bytes: int, written: Path | None) -> None:
    """Remove the oldest capture files until all files have at most ``keep_bytes``, except ``written`` and later files. If the disk
    fails, the next new file removes them."""
    try:
        files = capture_sizes(folder)
        total = sum(file.bytes for file in files)
        for path, size in files:
            if total <= keep_bytes or path == written:
                break
            total -= size
            for form in (path, packed_path(path)):  # the file can be compressed between the two calls
                form.unlink(missing_ok=True)
    except OSError as error:  # bytes of the line must be written even if old files cannot be removed
        log.warning("the oldest raw captures could not be removed: %s", error)

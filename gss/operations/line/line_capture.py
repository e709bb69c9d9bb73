"""The raw captures of successive contacts. A full disk does not end a contact: lost bytes are counted and reported."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from gss.operations.clock import Now
from gss.operations.line.raw_capture import RawCapture, Retention, capture_name

REMEMBERED = 8
"""Number of recent captures whose files are remembered."""


class LineCapture:
    """Writes the bytes of the line into files of ``folder``. ``complain`` reports a failure and its end; it must not block."""

    def __init__(self, folder: Path, retention: Retention, now: Now, complain: Callable[[str], None]) -> None:
        self.folder, self.retention = folder, retention
        self._now, self._complain = now, complain
        self._capture: RawCapture | None = None
        self._captures: OrderedDict[int, RawCapture] = OrderedDict()
        self.lost_bytes = 0
        """Bytes of the line that could not be written to the capture since the server started."""
        self.fails = ""
        """Why the capture is currently not written; "" if it is."""
        self._lost_from = 0
        self._contact_id = 0

    def begin(self, contact_id: int) -> str:
        """Start the capture of a contact and return the prefix of its files. If no file can be created, ``write`` tries
        again."""
        self._capture, self._contact_id = None, contact_id
        try:
            self._open()
        except OSError as error:
            self._failed(error, 0)
        return capture_name(contact_id)

    def _open(self) -> RawCapture:
        if self._capture is None:
            self._capture = RawCapture(self.folder, self._contact_id, self.retention)
            self._captures[self._contact_id] = self._capture
            while len(self._captures) > REMEMBERED:
                self._captures.popitem(last=False)
        return self._capture

    def write(self, direction: int, data: bytes) -> None:
        """Write bytes of the line, before anything else processes them. After a failure, each later call tries again."""
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
                self._complain(f"the raw capture goes on; {lost} bytes of the line are not in it")

    def _failed(self, error: OSError, lost_bytes: int) -> None:
        if not self.fails:
            self._lost_from = self.lost_bytes
            self._complain(f"the raw capture cannot be written, its record has a hole from here on: {error}")
        self.fails = str(error)
        self.lost_bytes += lost_bytes

    def files_of(self, contact_id: int) -> list[dict[str, object]] | None:
        """Return name and size of each file of a recent contact; None if no file was written."""
        capture = self._captures.get(contact_id)
        return capture.files if capture else None

    def end(self) -> None:
        """Close the capture of the contact."""
        if self._capture:
            self._capture.close()

    def keep_at_most(self, keep_bytes: int) -> None:
        """Set the total size beyond which the oldest files are removed."""
        self.retention = replace(self.retention, keep_bytes=keep_bytes)
        if self._capture is not None:
            self._capture.keep_at_most(keep_bytes)

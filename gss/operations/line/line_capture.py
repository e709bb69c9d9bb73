"""The raw capture of one contact after the other. A disk that takes nothing more ends no contact: the loss is counted and told."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from gss.operations.clock import Now
from gss.operations.line.raw_capture import RawCapture, Retention, capture_name

REMEMBERED = 8
"""Captures whose files are still known after the next one has begun."""


class LineCapture:
    """Writes the bytes of the line into files of ``folder``. ``complain`` reports a failure and its end; it must not block."""

    def __init__(self, folder: Path, retention: Retention, now: Now, complain: Callable[[str], None]) -> None:
        self.folder, self.retention = folder, retention
        self._now, self._complain = now, complain
        self._capture: RawCapture | None = None
        self._captures: OrderedDict[int, RawCapture] = OrderedDict()
        self.lost_bytes = 0
        """Bytes of the line that the capture could not take since the server started."""
        self.fails = ""
        """Why the capture is not being written now; "" while it is."""
        self._lost_from = 0
        self._contact_id = 0

    def begin(self, contact_id: int) -> str:
        """Start the capture of a contact and return the prefix of its files. If no file can be made, ``write`` tries again."""
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
        """Store a piece before anything else looks at it. After a failure each following piece is tried again."""
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
        """Name and bytes of each file of a recent contact; None where none was written."""
        capture = self._captures.get(contact_id)
        return capture.files if capture else None

    def end(self) -> None:
        """The contact ended."""
        if self._capture:
            self._capture.close()

    def keep_at_most(self, keep_bytes: int) -> None:
        """From now on the oldest files go when all together pass this."""
        self.retention = replace(self.retention, keep_bytes=keep_bytes)
        if self._capture is not None:
            self._capture.keep_at_most(keep_bytes)

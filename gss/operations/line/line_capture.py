"""The raw capture of one contact after the other. A disk that takes nothing more ends no contact: the loss is counted and told."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from gss.operations.clock import Now
from gss.operations.line.raw_capture import RawCapture, Retention


class LineCapture:
    """Writes what passes on the line into files of ``folder``. ``complain`` tells a failure and its end."""

    def __init__(self, folder: Path, retention: Retention, now: Now, complain: Callable[[str], None]) -> None:
        self.folder, self.retention = folder, retention
        self._now, self._complain = now, complain
        self._capture: RawCapture | None = None
        self.lost_bytes = 0
        """Bytes of the line that the capture could not take since the server started."""
        self.fails = ""
        """Why the capture is not being written now; "" while it is."""
        self._lost_from = 0

    def begin(self, contact_id: int) -> str:
        """A contact begins; the name that its files begin with."""
        self._capture = RawCapture(self.folder, contact_id, self.retention)
        return self._capture.name

    def write(self, direction: int, data: bytes) -> None:
        """First of all. After a failure each following piece is tried again."""
        if not data or self._capture is None:
            return
        try:
            self._capture.write(self._now().timestamp(), direction, data)
        except OSError as error:
            if not self.fails:
                self._lost_from = self.lost_bytes
                self._complain(f"the raw capture cannot be written, its record has a hole from here on: {error}")
            self.fails = str(error)
            self.lost_bytes += len(data)
        else:
            if self.fails:
                self.fails = ""
                lost = self.lost_bytes - self._lost_from
                self._complain(f"the raw capture goes on; {lost} bytes of the line are not in it")

    @property
    def files(self) -> list[dict[str, object]] | None:
        """Name and bytes of each file of the contact; None before the first."""
        return self._capture.files if self._capture else None

    def end(self) -> None:
        """The contact ended."""
        if self._capture:
            self._capture.close()

    def keep_at_most(self, keep_bytes: int) -> None:
        """From now on the oldest files go when all together pass this."""
        self.retention = replace(self.retention, keep_bytes=keep_bytes)
        if self._capture is not None:
            self._capture.keep_at_most(keep_bytes)

"""File of the ABORTs that are not yet stored in the database. The file preserves these ABORTs if the server ends while
the database is locked."""

from __future__ import annotations

import contextlib
import json
import logging
import threading
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path

log = logging.getLogger("gss.commands")


@dataclass(frozen=True)
class IssuedAbort:
    """An ABORT that was queued for the line. ``at``: ISO 8601, UTC."""

    request_id: int
    user: str
    source: str
    at: str

    @property
    def moment(self) -> datetime:
        """``at`` as a datetime."""
        return datetime.fromisoformat(self.at)


class AbortJournal:
    """File of JSON lines, one line per ABORT. If the file cannot be written, the failure is logged and ABORT is not delayed."""

    def __init__(self, path: Path) -> None:
        self._path, self._lock = path, threading.Lock()
        self._recorded_early: set[int] = set()
        """Request ids of ABORTs whose row was stored before ``add`` was called. This happens if the dispatcher is
        faster than the thread that issued the ABORT."""
        self._open: dict[int, IssuedAbort] = {entry.request_id: entry for entry in self._read()}

    def entries(self) -> list[IssuedAbort]:
        """Return the ABORTs whose rows are not stored yet, oldest first."""
        with self._lock:
            return [self._open[number] for number in sorted(self._open)]

    def add(self, entry: IssuedAbort) -> None:
        """Add a queued ABORT unless its row is already stored."""
        with self._lock:
            if entry.request_id in self._recorded_early:
                self._recorded_early.remove(entry.request_id)
                return
            self._open[entry.request_id] = entry
            self._write()

    def remove(self, request_id: int) -> None:
        """Remove an ABORT whose row was stored in the database."""
        with self._lock:
            if self._open.pop(request_id, None) is None:
                self._recorded_early.add(request_id)
            else:
                self._write()

    def _write(self) -> None:
        try:
            self._path.write_text("".join(json.dumps(asdict(entry)) + "\n" for entry in self._open.values()))
        except OSError as error:
            log.warning("ABORT could not be written to %s: %s", self._path.name, error)

    def _read(self) -> list[IssuedAbort]:
        entries = []
        with contextlib.suppress(OSError):
            for line in self._path.read_text().splitlines():
                with contextlib.suppress(ValueError, TypeError):  # a crash can truncate a line
                    entries.append(IssuedAbort(**json.loads(line)))
        return entries

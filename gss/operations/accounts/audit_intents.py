"""Intents of changes. An intent is written to a file before its change starts. If the server is killed between a change and its
audit row, the next start writes the row."""

from __future__ import annotations

import fcntl
import json
import logging
import os
import threading
import uuid
import weakref
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TextIO

from gss.operations.accounts.audit import AuditService

log = logging.getLogger("gss.audit")
ENDED = "the server ended before the result was recorded"


@dataclass(frozen=True)
class Intent:
    """A change that will start. ``at``: ISO 8601, UTC."""

    who: str
    role: str
    action: str
    target: str
    address: str
    at: str


class AuditIntents:
    """Writes intents as JSON lines to a file of this process. The file is locked while the process lives and empty while no
    change is in progress."""

    def __init__(self, folder: Path, audit: AuditService) -> None:
        self._folder, self._audit = folder, audit
        self._lock = threading.Lock()
        self._file: TextIO | None = None
        self._open: set[int] = set()
        self._number = 0

    def begin(self, intent: Intent) -> int:
        """Store an intent on the disk and return its number for ``end``. If the disk cannot be written, the failure is logged and
        the change is not prevented."""
        with self._lock:
            self._number += 1
            self._open.add(self._number)
            try:
                self._append({"begin": self._number, **asdict(intent)})
            except OSError as error:
                log.warning("the intent of %s by %s was not stored: %s", intent.action, intent.who, error)
            return self._number

    def end(self, number: int) -> None:
        """Remove an intent after its audit row was stored."""
        with self._lock:
            self._open.discard(number)
            if self._file is None:
                return
            try:
                if self._open:
                    self._append({"end": number})
                else:
                    self._file.truncate(0)
            except OSError as error:
                log.warning("an intent was not removed: %s", error)

    def recover(self) -> int:
        """Write audit rows for the open intents of ended processes, and return the number of rows."""
        rows = 0
        for path in sorted(self._folder.glob("*.jsonl")):
            with path.open("a+") as file:
                try:
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    continue  # the file belongs to a running process
                file.seek(0)
                for intent in _open_intents(file):
                    self._audit.record(
                        intent.who,
                        intent.action,
                        intent.target,
                        "unknown",
                        f"{ENDED}; began {intent.at}",
                        role=intent.role,
                        address=intent.address,
                    )
                    rows += 1
                path.unlink()
        return rows

    def _append(self, values: dict[str, object]) -> None:
        if self._file is None:
            self._folder.mkdir(parents=True, exist_ok=True)
            file = (self._folder / f"{uuid.uuid4().hex}.jsonl").open("a")
            fcntl.flock(file, fcntl.LOCK_EX)
            self._file = file
            # Closes the file of a service that was created but never started, because such a service is never stopped.
            weakref.finalize(self, file.close)
        self._file.write(json.dumps(values) + "\n")
        self._file.flush()
        os.fdatasync(self._file.fileno())

    def close(self) -> None:
        """Close the file, and remove it if no change is in progress."""
        with self._lock:
            if self._file is not None:
                if not self._open:
                    Path(self._file.name).unlink(missing_ok=True)
                self._file.close()
                self._file = None


def _open_intents(file: TextIO) -> Iterator[Intent]:
    """Yield the intents that began and did not end. A truncated last line is ignored, because a change starts only
    after its line was written completely."""
    begun: dict[int, Intent] = {}
    for line in file:
        try:
            values = json.loads(line)
            number = values.pop("begin", None)
            if number is None:
                begun.pop(values["end"], None)
            else:
                begun[number] = Intent(**values)
        except (ValueError, TypeError, KeyError):
            continue
    yield from begun.values()

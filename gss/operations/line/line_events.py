"""Events that the link publishes, in batches that carry the time at which their bytes arrived.

The line thread publishes and never waits; a ``Dispatcher`` on a separate thread passes the batches to the services, which may
wait for the store. A locked or full database therefore delays neither the line nor ABORT.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import Any

from gss.device.session_events import CommandStage, LinkCounters, SessionEvent, Telemetry
from gss.operations.clock import Monotonic, Now

MOST_WAITING = 20_000
"""Maximum number of waiting events, about five minutes of a busy line; beyond it telemetry is kept only in the raw capture."""


@dataclass(frozen=True)
class LineOpened:
    """The port was opened. ``contact_id``: number reserved for the contact; ``capture``: prefix of its raw files; ``counters``: of
    the session at that time."""

    url: str
    contact_id: int
    capture: str
    counters: LinkCounters


@dataclass(frozen=True)
class LineClosed:
    """The port was closed or lost. ``counters``: of the session at its end."""

    cause: str
    counters: LinkCounters


@dataclass(frozen=True)
class LinkFault:
    """A fault on the ground's side of the line, to be recorded."""

    severity: str
    text: str


@dataclass(frozen=True)
class AbortIssued:
    """ABORT was put at the head of the line's queue. ``withdrawn``: commands removed from the queue by it; ``recorded``:
    resolves to the command's row when it is stored."""

    request_id: int
    user: str
    source: str
    at: datetime
    withdrawn: tuple[CommandStage, ...]
    recorded: Future[Any] = field(default_factory=Future, compare=False)


class ServiceEvent:
    """Base of the events that a service derives from a batch, for the services after it in the dispatch table."""


LineEvent = SessionEvent | LineOpened | LineClosed | LinkFault | AbortIssued | ServiceEvent


@dataclass(frozen=True)
class LineBatch:
    """Events in their order. ``at`` (UTC) and ``at_s`` (monotonic clock, seconds): when they were published."""

    events: tuple[LineEvent, ...]
    at: datetime
    at_s: float

    def with_derived(self, derived: Sequence[ServiceEvent]) -> LineBatch:
        """Return the batch with events appended that a service derived from it."""
        return replace(self, events=(*self.events, *derived))


class LineEventQueue:
    """Queue of batches between the line and the services. ``publish`` never blocks."""

    def __init__(self, now: Now, monotonic_s: Monotonic, most: int = MOST_WAITING) -> None:
        self._now, self._monotonic_s, self._most = now, monotonic_s, most
        self._batches: deque[LineBatch] = deque()
        self._changed = threading.Condition()
        self._in_progress = False
        self.depth = 0
        """Number of waiting events."""
        self.dropped = 0
        """Telemetry packets dropped since the server started because the queue was full."""
        self.hold = threading.RLock()
        """Held by the dispatcher while it passes on a batch. A service that starts something and then stores its row holds
        it too, so that no report is handled before the row exists. Acquire it before ``LinkService.lock``, never after."""

    def publish(self, events: Sequence[LineEvent]) -> None:
        """Append a batch. If too many events are waiting, its telemetry is dropped and counted; all other events are kept."""
        if not events:
            return
        with self._changed:
            kept = tuple(events)
            if self.depth >= self._most:
                kept = tuple(event for event in events if not isinstance(event, Telemetry))
                self.dropped += len(events) - len(kept)
            if not kept:
                return
            self._batches.append(LineBatch(kept, self._now(), self._monotonic_s()))
            self.depth += len(kept)
            self._changed.notify_all()

    def take(self, timeout_s: float) -> LineBatch | None:
        """Return the oldest batch, or None if none arrives within ``timeout_s``. Call ``done`` after handling it."""
        with self._changed:
            if not self._batches:
                self._changed.wait(timeout_s)
            if not self._batches:
                return None
            batch = self._batches.popleft()
            self.depth -= len(batch.events)
            self._in_progress = True
            return batch

    def done(self) -> None:
        """Mark the last batch taken as handled."""
        with self._changed:
            self._in_progress = False
            self._changed.notify_all()

    def wait_until_handled(self, timeout_s: float) -> bool:
        """Wait until no batch is queued or being handled. Return False after ``timeout_s``."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._batches and not self._in_progress, timeout_s)

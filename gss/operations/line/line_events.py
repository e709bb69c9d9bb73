"""Events that the link publishes in batches, with the time at which they were published."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import Any

from gss.device.session_events import CommandUpdate, LinkCounters, SessionEvent


@dataclass(frozen=True)
class LineOpened:
    """The port was opened. ``contact_id``: id reserved for the contact. ``capture``: prefix of the names of its raw capture
    files. ``counters``: counters of the session at that time. ``continued``: the contact existed before, and its line was lost
    for a few seconds."""

    url: str
    contact_id: int
    capture: str
    counters: LinkCounters
    continued: bool = False


@dataclass(frozen=True)
class LineClosed:
    """The port was closed or lost. ``counters``: counters of the session at that time."""

    cause: str
    counters: LinkCounters


@dataclass(frozen=True)
class LinkFault:
    """A fault on the ground side of the line. The contact log records it."""

    severity: str
    text: str


@dataclass(frozen=True)
class AbortIssued:
    """ABORT was inserted at the head of the line's queue. ``withdrawn``: commands that ABORT removed from the queue.
    ``recorded``: resolves to the row of the command when it is stored."""

    request_id: int
    user: str
    source: str
    at: datetime
    withdrawn: tuple[CommandUpdate, ...]
    recorded: Future[Any] = field(default_factory=Future, compare=False)


class ServiceEvent:
    """Base class of events that a service derives from a batch for the services that are called after it."""


LineEvent = SessionEvent | LineOpened | LineClosed | LinkFault | AbortIssued | ServiceEvent


@dataclass(frozen=True)
class LineBatch:
    """Events in order. ``at`` (UTC) and ``at_s`` (monotonic clock, seconds): time at which they were published."""

    events: tuple[LineEvent, ...]
    at: datetime
    at_s: float

    def with_derived(self, derived: Sequence[ServiceEvent]) -> LineBatch:
        """Return the batch with appended events that a service derived from it."""
        return replace(self, events=(*self.events, *derived))

"""Events that the link publishes, in batches that carry the time at which their bytes arrived."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import Future
from dataclasses import dataclass, field, replace
from datetime import datetime
from typing import Any

from gss.device.session_events import CommandUpdate, LinkCounters, SessionEvent


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
    withdrawn: tuple[CommandUpdate, ...]
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

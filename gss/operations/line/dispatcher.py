"""Dispatch of line events to the services: the line thread fills a queue, and a dispatch thread passes each batch to the
services.

The line thread never waits. The services can wait for the store. A locked or full database therefore does not delay the line or
ABORT.
"""

from __future__ import annotations

import logging
import threading
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TypeVar

from gss.device.session_events import Telemetry
from gss.domain.errors import GssError
from gss.operations.clock import Monotonic, Now
from gss.operations.events import EventBus
from gss.operations.line.line_events import LineBatch, LineEvent, ServiceEvent
from gss.operations.metrics import MetricSample

log = logging.getLogger("gss.link")
T = TypeVar("T")

MAX_WAITING = 20_000
"""Maximum number of waiting events, about five minutes of a busy line. While more events wait, telemetry is dropped
from the queue and remains only in the raw capture."""
IDLE_S = 0.02
"""Interval of the periodic calls if no events arrive."""
STOP_WITHIN_S = 5.0
SLOW_AFTER_S = 20.0
"""The health check reports a batch that takes longer than this."""

Subscriber = Callable[[LineBatch], Sequence[ServiceEvent] | None]
"""Function that handles a batch. It returns events for the subscribers that are called after it."""


class LineEventQueue:
    """Queue of batches between the line and the services. ``publish`` never blocks."""

    def __init__(self, now: Now, monotonic_s: Monotonic, max_waiting: int = MAX_WAITING) -> None:
        self._now, self._monotonic_s, self._max_waiting = now, monotonic_s, max_waiting
        self._batches: deque[LineBatch] = deque()
        self._changed = threading.Condition()
        self._in_progress = False
        self.depth = 0
        """Number of waiting events."""
        self.dropped = 0
        """Number of telemetry packets dropped since the server started because the queue was full."""
        self.hold = threading.RLock()
        """Lock that the dispatcher holds while it dispatches a batch. A service also holds it while it starts a command or
        transfer and stores its row, so that no report is handled before the row exists. Acquire it before
        ``LinkService.lock``, never after."""

    def publish(self, events: Sequence[LineEvent]) -> None:
        """Append a batch. If too many events are waiting, telemetry of the batch is dropped and counted; its other events are
        queued."""
        if not events:
            return
        with self._changed:
            batch = tuple(events)
            if self.depth >= self._max_waiting:
                batch = tuple(event for event in events if not isinstance(event, Telemetry))
                self.dropped += len(events) - len(batch)
            if not batch:
                return
            self._batches.append(LineBatch(batch, self._now(), self._monotonic_s()))
            self.depth += len(batch)
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
        """Mark the batch returned by ``take`` as handled."""
        with self._changed:
            self._in_progress = False
            self._changed.notify_all()

    def wait_until_handled(self, timeout_s: float) -> bool:
        """Wait until no batch is queued or being handled. Return False after ``timeout_s``."""
        with self._changed:
            return self._changed.wait_for(lambda: not self._batches and not self._in_progress, timeout_s)


class Dispatcher:
    """Calls all subscribers with each batch, in the order of ``subscribers``. Events that a subscriber returns are passed to the
    subscribers after it.

    ``periodic``: functions called between batches, at intervals of ``IDLE_S`` or less while idle. If a subscriber raises an
    exception, the exception is logged and reported, and the other subscribers still receive the batch.
    """

    def __init__(
        self,
        events: LineEventQueue,
        bus: EventBus,
        monotonic_s: Monotonic,
        subscribers: Sequence[Subscriber],
        periodic: Sequence[Callable[[], None]] = (),
    ) -> None:
        self._events, self._bus, self._monotonic_s = events, bus, monotonic_s
        self._subscribers, self._periodic = tuple(subscribers), tuple(periodic)
        self._busy_since_s: float | None = None
        self._stopping = False
        self._thread = threading.Thread(target=self._run, name="dispatch", daemon=True)

    def start(self) -> None:
        """Start the thread."""
        self._thread.start()

    def stop(self) -> None:
        """Handle the waiting batches for at most ``STOP_WITHIN_S``, then end the thread."""
        if self._thread.ident is None:
            return
        self._events.wait_until_handled(STOP_WITHIN_S)
        self._stopping = True
        self._thread.join(timeout=IDLE_S * 10)

    @property
    def busy_s(self) -> float:
        """Seconds since the current batch was taken from the queue, 0 while idle."""
        since_s = self._busy_since_s
        return 0.0 if since_s is None else self._monotonic_s() - since_s

    @property
    def dropped(self) -> int:
        """Number of telemetry packets dropped because the queue was full."""
        return self._events.dropped

    def is_slow(self) -> bool:
        """True if the current batch has taken longer than ``SLOW_AFTER_S``."""
        return self.busy_s > SLOW_AFTER_S

    def samples(self) -> Iterator[MetricSample]:
        """Yield metrics: depth of the event queue and number of dropped telemetry packets."""
        depth, dropped = float(self._events.depth), float(self._events.dropped)
        yield MetricSample("gss_queue_depth", "Items waiting in a queue.", "gauge", depth, (("queue", "line events"),))
        yield MetricSample(
            "gss_line_events_dropped_total",
            "Telemetry packets dropped because the queue was full; they remain in the raw capture.",
            "counter",
            dropped,
        )

    def _run(self) -> None:
        while not self._stopping:
            batch = self._events.take(IDLE_S)
            self._busy_since_s = self._monotonic_s()
            with self._events.hold:
                if batch is not None:
                    self._dispatch(batch)
                for call in self._periodic:
                    self._guarded(call)
            self._busy_since_s = None
            if batch is not None:
                self._events.done()

    def _dispatch(self, batch: LineBatch) -> None:
        for subscriber in self._subscribers:
            derived = self._guarded(partial(subscriber, batch))
            batch = batch.with_derived(derived or ())

    def _guarded(self, call: Callable[[], T]) -> T | None:
        try:
            return call()
        except Exception as error:  # a defect of one service must not affect the other services
            log.exception("%r failed", call)
            try:
                text = f"Received data could not be processed: {type(error).__name__}: {error}"
                self._bus.record("link", "critical", text)
            except GssError:
                log.exception("not recorded")
            return None

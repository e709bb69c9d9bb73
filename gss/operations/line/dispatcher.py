"""Passes the batches that the link publishes to the services, one at a time, on a separate thread."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TypeVar

from gss.domain.errors import GssError
from gss.operations.clock import Monotonic
from gss.operations.events import EventBus
from gss.operations.line.line_events import LineBatch, LineEventQueue, ServiceEvent
from gss.operations.upkeep.metrics import Sample

log = logging.getLogger("gss.link")
T = TypeVar("T")

IDLE_S = 0.02
"""Interval of the periodic calls while no events arrive."""
STOP_WITHIN_S = 5.0
SLOW_AFTER_S = 20.0
"""A batch that takes longer is reported by the health check."""

Subscriber = Callable[[LineBatch], Sequence[ServiceEvent] | None]
"""Handles a batch and returns the events that it derives from it for the subscribers after it."""


class Dispatcher:
    """Calls every subscriber with each batch, in the order given. Events derived by one subscriber are passed to those after
    it.

    ``periodic`` is called between batches, at least every ``IDLE_S``.
    A subscriber that raises is logged and reported; the others still get the batch.
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
        """Seconds since the batch in progress was taken; 0 while idle."""
        since_s = self._busy_since_s
        return 0.0 if since_s is None else self._monotonic_s() - since_s

    def is_slow(self) -> bool:
        """True if one batch has been in progress for longer than ``SLOW_AFTER_S``."""
        return self.busy_s > SLOW_AFTER_S

    def samples(self) -> Iterator[Sample]:
        """Yield metrics: depth of the event queue and number of dropped telemetry packets."""
        depth, dropped = float(self._events.depth), float(self._events.dropped)
        yield Sample("gss_queue_depth", "What waits in a queue.", "gauge", depth, (("queue", "line events"),))
        yield Sample("gss_line_events_dropped_total", "Telemetry left to the raw capture.", "counter", dropped)

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
        except Exception as error:  # one service's defect must not keep the batch from the others
            log.exception("%r failed", call)
            try:
                text = f"Received data could not be processed: {type(error).__name__}: {error}"
                self._bus.record("link", "critical", text)
            except GssError:
                log.exception("not recorded")
            return None

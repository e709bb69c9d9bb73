"""Stores received content on a separate thread, in order of arrival, so that a slow store does not delay telemetry."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future, wait
from dataclasses import dataclass, field
from typing import Any

from gss.device.session_events import TransferUpdate
from gss.operations.clock import Monotonic
from gss.operations.events import EventBus
from gss.operations.transfers.content_events import Answers
from gss.operations.upkeep.metrics import Sample
from gss.store.models import Transfer

MOST_WAITING = 4
"""Maximum number of waiting jobs. When it is reached, no other download is started, and content that still arrives blocks
the caller."""


class Writer:
    """Runs one job at a time on a background thread; an event is recorded each time its queue is full.

    This is not a thread pool of the library: at exit, Python waits for a pool's threads, and a store may hang.
    """

    def __init__(self, monotonic_s: Monotonic, bus: EventBus, most: int = MOST_WAITING) -> None:
        self._monotonic_s, self._bus, self._most = monotonic_s, bus, most
        self._jobs: queue.Queue[tuple[Future[Any], Callable[[], Any]]] = queue.Queue(most)
        self._open: set[Future[Any]] = set()
        self._thread: threading.Thread | None = None
        self.waits = 0
        """Number of times that the caller had to wait since the server started."""
        self.waited_s = 0.0
        """Total time of these waits in seconds."""

    @property
    def full(self) -> bool:
        """True if the queue is full."""
        return self._jobs.full()

    def submit(self, work: Callable[[], Any]) -> Future[Any]:
        """Queue a job. Jobs are never dropped: if the queue is full, the caller waits."""
        if self._thread is None:
            self._thread = threading.Thread(target=self._run, name="writer", daemon=True)
            self._thread.start()
        job: Future[Any] = Future()
        self._open.add(job)
        job.add_done_callback(self._open.discard)
        try:
            self._jobs.put_nowait((job, work))
        except queue.Full:
            self.waits += 1
            self._bus.record("transfer", "warning", "received content is not stored as fast as it arrives")
            since_s = self._monotonic_s()
            self._jobs.put((job, work))
            self.waited_s += self._monotonic_s() - since_s
        return job

    def samples(self) -> Iterator[Sample]:
        """Yield metrics: depth of the queue, number and duration of waits."""
        depth = float(self._jobs.qsize())
        yield Sample("gss_queue_depth", "What waits in a queue.", "gauge", depth, (("queue", "store"),))
        yield Sample("gss_line_waits_total", "How often the line waited for a store.", "counter", self.waits)
        yield Sample("gss_line_waited_seconds_total", "How long in all.", "counter", self.waited_s)

    def finish(self, within_s: float) -> None:
        """Wait until all jobs are done, but no longer than ``within_s``, because a store may hang."""
        wait(list(self._open), within_s)

    def _run(self) -> None:
        while True:
            job, work = self._jobs.get()
            try:
                job.set_result(work())
            except BaseException as error:  # the error is raised where the result is read
                job.set_exception(error)


@dataclass
class Storing:
    """A transfer whose content is being stored. ``transfer_id``: the session's id; None if the transfer broke off. ``held``:
    its updates received meanwhile, which are published afterwards."""

    row: Transfer
    answers: Answers
    transfer_id: int | None
    held: list[TransferUpdate] = field(default_factory=list)
    linked: bool = False
    """True once the outcome is in the transfer's row."""
    keeps_part: bool = False
    """True if the content was not stored, so that the download can be resumed."""

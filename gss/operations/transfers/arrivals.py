"""Received content of transfers: events that report received content, answers of the services that store the content,
and the thread that runs the storing. Content is stored in order of arrival, and a slow store does not delay
telemetry."""

from __future__ import annotations

import queue
import threading
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, wait
from dataclasses import dataclass, field
from typing import Any

from gss.device.session_events import TransferDone, TransferUpdate
from gss.domain.errors import StoreDown
from gss.domain.json_object import JsonObject
from gss.operations.clock import Monotonic
from gss.operations.events import EventBus
from gss.operations.line.line_events import ServiceEvent
from gss.operations.metrics import MetricSample
from gss.store.models import Transfer

MAX_WAITING = 4
"""Maximum number of waiting jobs. When it is reached, no further download is started, and the caller that delivers more
content must wait."""


class Writer:
    """Runs one job at a time on a background thread. An event is recorded each time the queue is full.

    ThreadPoolExecutor is not used, because Python waits at exit for the threads of an executor, and the store can hang.
    """

    def __init__(self, monotonic_s: Monotonic, bus: EventBus, max_waiting: int = MAX_WAITING) -> None:
        self._monotonic_s, self._bus = monotonic_s, bus
        self._jobs: queue.Queue[tuple[Future[Any], Callable[[], Any]]] = queue.Queue(max_waiting)
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
        """Queue a job. If the queue is full, the caller waits, because jobs are never dropped."""
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
            self._bus.record("transfer", "warning", "Received data arrives faster than it is stored")
            since_s = self._monotonic_s()
            self._jobs.put((job, work))
            self.waited_s += self._monotonic_s() - since_s
        return job

    def samples(self) -> Iterator[MetricSample]:
        """Yield metrics: depth of the queue, number and duration of waits."""
        depth = float(self._jobs.qsize())
        yield MetricSample("gss_queue_depth", "Items waiting in a queue.", "gauge", depth, (("queue", "store"),))
        yield MetricSample("gss_line_waits_total", "Waits of the line for the store.", "counter", self.waits)
        yield MetricSample("gss_line_waited_seconds_total", "Total waiting time.", "counter", self.waited_s)

    def finish(self, within_s: float) -> None:
        """Wait until all jobs are done, but no longer than ``within_s``, because a store can hang."""
        wait(list(self._open), within_s)

    def _run(self) -> None:
        while True:
            job, work = self._jobs.get()
            try:
                job.set_result(work())
            except BaseException as error:  # the error is raised when the result is read
                job.set_exception(error)


Links = JsonObject
"""Columns of the transfer's row that refer to rows created from its content, such as ``frame_id``."""


MAX_TRIES = 3
"""Maximum number of attempts to store received content while the store is down."""


class Later:
    """Links that are available after ``work`` has stored the content. ``links``: function that returns the links for
    the result of ``work``; it is called on the dispatcher's thread."""

    def __init__(
        self,
        submit: Callable[[Callable[[], Any]], Future[Any]],
        work: Callable[[], Any],
        links: Callable[[Any], Links],
    ) -> None:
        self._submit, self._work, self._links, self._tries = submit, work, links, 1
        self._job = submit(work)

    def done(self) -> bool:
        """True if the work has ended."""
        return self._job.done()

    def start_again(self) -> bool:
        """Repeat the work if the store was down. Return False if the store was not down or after MAX_TRIES attempts."""
        if not isinstance(self._job.exception(), StoreDown) or self._tries >= MAX_TRIES:
            return False
        self._tries += 1
        self._job = self._submit(self._work)
        return True

    def result(self) -> Links:
        """Return the links. Raises the exception of ``work``."""
        return self._links(self._job.result())


class Answers:
    """Collects the links that the subscribers return for received content."""

    def __init__(self) -> None:
        self._now: list[Links] = []
        self._later: list[Later] = []
        self._errors: list[Exception] = []

    def accept(self, store: Callable[[], Links | Later]) -> None:
        """Store the content. An error means that the content cannot be used, and is reported with the transfer."""
        try:
            answer = store()
        except Exception as error:  # after any error, the transfer must not be reported as complete
            self._errors.append(error)
            return
        if isinstance(answer, Later):
            self._later.append(answer)
        else:
            self._now.append(answer)

    def ready(self) -> bool:
        """True if all storing jobs have ended. Jobs that failed because the store was down are started again."""
        return all(later.done() and not later.start_again() for later in self._later)

    @property
    def missing(self) -> bool:
        """True if no subscriber answered."""
        return not (self._now or self._later or self._errors)

    def links(self) -> Links:
        """Return all links. Raises the first storing error."""
        if self._errors:
            raise self._errors[0]
        links_by_slot: Links = {}
        for links in [*self._now, *(later.result() for later in self._later)]:
            links_by_slot |= links
        return links_by_slot


@dataclass(frozen=True)
class ContentArrived(ServiceEvent):
    """A transfer in either direction is complete. Its row is closed when the answers of all subscribers are ready."""

    transfer: Transfer
    done: TransferDone
    answers: Answers = field(default_factory=Answers, compare=False)


@dataclass(frozen=True)
class PartArrived(ServiceEvent):
    """A download was interrupted. ``data``: (size,) bytes, zeros for missing chunks; ``ranges``: ranges of received
    chunks."""

    transfer: Transfer
    data: bytes
    ranges: Sequence[tuple[int, int]]
    update: TransferUpdate
    answers: Answers = field(default_factory=Answers, compare=False)


@dataclass
class Storing:
    """A transfer whose content is being stored. ``transfer_id``: id of the transfer in the session, None for an
    interrupted transfer; ``deferred``: updates received while the content is stored, which are published afterwards."""

    row: Transfer
    answers: Answers
    transfer_id: int | None
    deferred: list[TransferUpdate] = field(default_factory=list)
    linked: bool = False
    """True after the outcome has been written to the transfer's row."""
    keeps_part: bool = False
    """True if the content was not stored, so that the download can be resumed."""

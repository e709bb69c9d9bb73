"""Jobs: long work that is queued, reports progress, can be cancelled, stores its result, and resumes after a crash.

Each kind of job has a request type and a work function. The request is stored and contains everything that the function
needs, so the next server process can continue the job. The function stores checkpoints. After a crash it is called with
the latest checkpoint and must produce the same result. Without a checkpoint it starts from the beginning. A job is not
resumed again if the server crashed three times while the job was running and made no progress.
"""

from __future__ import annotations

import contextlib
import logging
import math
import threading
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any, Generic, Protocol, TypeVar

from pydantic import TypeAdapter, ValidationError

from gss.domain.errors import BadInput, Conflict, GssError, StoreDown
from gss.domain.json_object import JsonObject
from gss.operations.clock import Now, stopwatch_s
from gss.operations.events import EventBus
from gss.operations.job_rules import ALWAYS, CANCELLING, ENDED, UNFINISHED, can_start_again, reason_of
from gss.operations.requests import as_stored
from gss.store import jobs as store
from gss.store.engine import Database
from gss.store.models import Job

log = logging.getLogger("gss.jobs")
PUBLISH_EVERY_S = 0.1
RETRY_S = 1.0
"""Pause before the end of a job is stored again after the store failed."""
MAX_DEATHS = 3


class Cancelled(Exception):
    """Raised inside a job's work at the first progress report after the job was cancelled."""


Progress = Callable[[int, int, str], None]


class Keep(Protocol):
    """Stores a checkpoint. With a ``session``, the checkpoint is stored in the same transaction as the data it refers to."""

    def __call__(self, checkpoint: JsonObject, session: Any = None) -> None: ...


@dataclass(frozen=True)
class JobRun:
    """Context of a job's work. ``checkpoint``: the last checkpoint that ``keep`` stored, None if there is none."""

    checkpoint: JsonObject | None
    progress: Progress
    keep: Keep


JobResult = Mapping[str, object]
"""Result of a job as JSON. Its fields depend on the kind of job."""
Work = Callable[[JobRun], JobResult]


@dataclass(frozen=True)
class JobRequest:
    """Stored request of a job, with everything that its work needs. ``user``: the user who started the job."""

    user: str = field(default="", kw_only=True)


R = TypeVar("R", bound=JobRequest)
T = TypeVar("T")


@dataclass(frozen=True)
class JobKind(Generic[R]):
    """A kind of job, one of :data:`KINDS`. ``renewed``: replaces outdated parts of the request before a job is
    continued or repeated. ``repeated``: replaces outdated parts only before a job is repeated. ``older``: converts a
    request that an earlier version stored."""

    name: str
    request: type[R]
    work: Callable[[R, JobRun], JobResult]
    renewed: Callable[[R], R] | None = None
    repeated: Callable[[R], R] | None = None
    older: Callable[[JsonObject], JsonObject] | None = None

    def read(self, stored: JsonObject) -> R:
        """Return the request of a stored job. Raises BadInput if another version stored a request that this version cannot
        use."""
        try:
            return TypeAdapter(self.request).validate_python(self.older(stored) if self.older else stored)
        except ValidationError as error:
            raise BadInput(
                "this request was stored by another version",
                got=str(error.errors()[0]["msg"]),
                hint="start a new job from its page",
            ) from None

    def current(self, request: R) -> R:
        """Return the request with its outdated parts replaced."""
        return self.renewed(request) if self.renewed else request


LEFT_TO_THE_NEXT = "The server is stopping. The job continues after the next start."


def _at_once(write: Callable[[], object]) -> None:
    write()


class JobService:
    """Runs jobs one at a time on a thread. ``check_room`` raises StoreDown if the disk has no room for a job's results."""

    def __init__(self, database: Database, bus: EventBus, now: Now, check_room: Callable[[str], None]) -> None:
        self._database, self._bus, self._now, self.check_room = database, bus, now, check_room
        self._pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix="job")
        self._cancel: dict[int, threading.Event] = {}
        self._kinds: dict[str, JobKind[Any]] = {}
        self._stopping = False
        self._last_attempt = threading.Event()
        """Set when a failed write is repeated only once more, so that a failing store does not delay the end of the
        process."""
        self._marking = threading.RLock()
        """Lock for checking and then changing a job's state. It prevents other threads from changing the state in
        between."""

    def register(self, kind: JobKind[Any]) -> None:
        """Register a kind of job. :meth:`start` then also resumes unfinished jobs of this kind."""
        self._kinds[kind.name] = kind

    def start(self) -> None:
        """Resume the jobs that the previous server did not finish. Jobs that cannot be resumed fail; their requests remain
        stored."""
        with self._database.unit_of_work() as session:
            unfinished = store.in_states(session, UNFINISHED)
        for job in unfinished:
            deaths = job.attempts + (job.state == "running")
            if job.state == CANCELLING:
                self._mark_cancelled(job.id)
            elif job.kind not in self._kinds:
                self._fail(job, "The server stopped before the job ended. Start it again.")
            elif deaths >= MAX_DEATHS:
                self._fail(job, f"The server stopped {deaths} times during this job. It is not retried automatically.")
            else:
                self._continue(job, deaths)

    def _continue(self, job: Job, deaths: int) -> None:
        kind = self._kinds[job.kind]
        try:
            request = kind.current(kind.read(job.request))
        except GssError as error:
            self._fail(job, error.sentences())
            return
        text = f"The server restarted. The job {'continues' if job.checkpoint else 'starts again'}."
        self._update(job.id, state="queued", attempts=deaths, text=text, request=as_stored(request))
        self._queue(job.id, partial(kind.work, request))

    def interrupt(self) -> None:
        """Cancel all jobs, including jobs that are queued later. Running jobs that can resume are stored as queued
        immediately, so the end of the process does not count as a crash. Can be called repeatedly and from any
        thread."""
        self._stopping = True
        self._last_attempt.set()
        for event in list(self._cancel.values()):
            event.set()
        with contextlib.suppress(StoreDown):
            for job_id in list(self._cancel):
                self._leave_to_the_next(job_id)

    def _leave_to_the_next(self, job_id: int) -> None:
        with self._marking:
            job = self.get(job_id)
            if job.kind in self._kinds and job.state == "running":
                self._update(job_id, state="queued", text=LEFT_TO_THE_NEXT)

    def stop(self) -> None:
        """Stop all jobs and wait until they have ended. Resumable jobs stay queued for the next server. All other jobs are
        cancelled."""
        self.interrupt()
        self._pool.shutdown(wait=True, cancel_futures=True)

    def finish(self) -> None:
        """Wait until all queued jobs have ended. No job can be queued afterwards."""
        self._last_attempt.set()
        self._pool.shutdown(wait=True)

    def begin(self, kind: str, title: str, request: JobRequest, work: Work | None = None) -> Job:
        """Queue a job of a registered kind and return its row immediately. ``work``: the work for this request, if the caller
        has already prepared it."""
        job = self._add(kind, title, as_stored(request))
        self._queue(job.id, work or partial(self._kinds[kind].work, request))
        return job

    def again(self, job_id: int, *, user: str) -> Job:
        """Start an ended job again from its stored request, on behalf of ``user``. Raises Conflict if its kind does not
        permit that."""
        old = self.get(job_id)
        if not can_start_again(old) or old.kind not in self._kinds:
            raise Conflict(
                "this job cannot be started again",
                expected="an ended job with a stored request",
                got=f"{old.kind}, {old.state}",
            )
        kind = self._kinds[old.kind]
        request = kind.current(kind.read(old.request))
        request = kind.repeated(request) if kind.repeated else request
        return self.begin(old.kind, old.title, replace(request, user=user))

    def cancel(self, job_id: int) -> Job:
        """Cancel a job. A started job ends at its next progress report. Raises Conflict if the job has already ended."""
        with self._marking:
            job = self.get(job_id)
            if job.state in ENDED:
                raise Conflict("this job has ended", expected="a queued or running job", got=job.state)
            cancel = self._cancel.get(job_id)
            if cancel is not None:
                cancel.set()
            if job.state == "queued" or cancel is None:
                return self._mark_cancelled(job_id)
            return self._update(job_id, state=CANCELLING, text="Cancelling")

    def get(self, job_id: int) -> Job:
        """Return the job with that id. Raises NotFound."""
        with self._database.unit_of_work() as session:
            return store.get(session, job_id)

    def newest(self, limit: int, kind: str = "") -> list[Job]:
        """Return the latest jobs, at most ``limit``, newest first. ``kind``: only jobs of this kind."""
        with self._database.unit_of_work() as session:
            return store.newest(session, limit, kind)

    def waiting(self) -> int:
        """Return the number of queued and running jobs."""
        return len(self._cancel)

    # --- running ------------------------------------------------------------------------------------------------

    def _add(self, kind: str, title: str, request: JsonObject) -> Job:
        if kind not in ALWAYS:
            self.check_room("a new job")
        row = Job(
            kind=kind, title=title, state="queued", text="Waiting", created=self._now(), request=request, result={}
        )
        row.done = row.total = row.attempts = 0
        with self._database.unit_of_work() as session:
            return store.add(session, row)

    def _queue(self, job_id: int, work: Work) -> None:
        cancel = self._cancel[job_id] = threading.Event()
        job = self.get(job_id)
        if self._stopping or job.state in ENDED:  # a user can cancel a job as soon as its row is stored
            cancel.set()
        self._bus.publish("job", job)
        self._pool.submit(self._run, job_id, work)

    def _run(self, job_id: int, work: Work) -> None:
        try:
            self._work(self._until_stored(partial(self.get, job_id)), work)
        except StoreDown:
            # The server is stopping. The row is unfinished, so that the next server continues the job.
            log.exception("the end of job %d could not be stored", job_id)
        finally:
            self._cancel.pop(job_id, None)

    def _work(self, job: Job, work: Work) -> None:
        job_id, cancel = job.id, self._cancel[job.id]
        published_s, last = -math.inf, {"done": job.done, "total": job.total}

        def progress(done: int, total: int, text: str) -> None:
            nonlocal published_s, last
            with self._marking:
                if cancel.is_set():
                    raise Cancelled
                # Work can report progress thousands of times. Storing a row and sending a message for each report would
                # take longer than the work.
                now_s, last = stopwatch_s(), {"done": done, "total": total}
                if now_s - published_s >= PUBLISH_EVERY_S:
                    published_s = now_s
                    self._update(job_id, state="running", done=done, total=total, text=text)

        def keep(checkpoint: JsonObject, session: Any = None) -> None:
            if session is None:
                with self._database.unit_of_work() as unit_session:
                    store.keep(unit_session, job_id, checkpoint)
            else:
                store.keep(session, job_id, checkpoint)

        try:
            progress(job.done, job.total, "Started")
            result = work(JobRun(job.checkpoint, progress, keep))
        except Cancelled:
            self._until_stored(partial(self._interrupted, job_id, last))
        except Exception as error:  # a defect in a job must be shown as a failure and must not end the thread
            self._fail(job, reason_of(error), self._until_stored)
        else:
            self._store_result(job, result, last)

    def _store_result(self, job: Job, result: JobResult, last: dict[str, int]) -> None:
        ended = {"state": "done", "text": "Done", "checkpoint": None, "finished": self._now()}
        try:
            self._until_stored(partial(self._update, job.id, result=result, **ended, **last))
        except StoreDown:
            raise
        except Exception as error:  # the database cannot hold this result
            self._fail(job, reason_of(error), self._until_stored)

    def _until_stored(self, access: Callable[[], T]) -> T:
        """Repeat an access to the store until it succeeds. Raises StoreDown if it fails while the server is stopping."""
        while True:
            is_last = self._last_attempt.is_set()
            try:
                return access()
            except StoreDown:
                if is_last:
                    raise
            self._last_attempt.wait(RETRY_S)

    def _interrupted(self, job_id: int, last: dict[str, int]) -> None:
        """Mark a job as cancelled, or as queued if the server is stopping and the next server can resume the job."""
        with self._marking:
            job = self.get(job_id)
            if job.state in ENDED:
                return
            if self._stopping and job.state != CANCELLING and job.kind in self._kinds:
                self._update(job_id, state="queued", text=LEFT_TO_THE_NEXT, **last)
            else:
                self._mark_cancelled(job_id, **last)

    def _mark_cancelled(self, job_id: int, **last: int) -> Job:
        return self._update(job_id, state="cancelled", text="Cancelled", finished=self._now(), **last)

    def _fail(self, job: Job, text: str, run: Callable[[Callable[[], object]], object] = _at_once) -> None:
        """Store that a job failed. ``run``: runs each of both writes, so that a retry does not record a second event."""
        run(partial(self._bus.record, "job", "warning", f"{job.title}: {text}", job_id=job.id))
        run(partial(self._update, job.id, state="failed", text=text, finished=self._now()))

    def _update(self, job_id: int, **values: Any) -> Job:
        with self._marking, self._database.unit_of_work() as session:
            job = store.get(session, job_id)
            for name, value in values.items():
                setattr(job, name, value)
        self._bus.publish("job", job)
        return job

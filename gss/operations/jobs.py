"""Jobs: long work that is queued, reports progress, can be cancelled, stores its result, and resumes after a crash.

*Resumable* work is created from its stored request alone, so that the next server can create it again. It stores checkpoints;
after a crash it is called with the newest one and must end with the same result. Work without a checkpoint starts from the
beginning. A job during which the server died three times without progress is not tried again.
"""

from __future__ import annotations

import contextlib
import math
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any, Protocol

from gss.domain.errors import Conflict, GssError, StoreDown
from gss.operations.clock import Now, stopwatch_s
from gss.operations.events import EventBus
from gss.store import jobs as store
from gss.store.engine import Database
from gss.store.models import Job

TELL_EVERY_S = 0.1
MOST_DEATHS = 3
ENDED = ("done", "failed", "cancelled")
KINDS = ("experiments", "campaign", "reprocess", "catalogue", "design", "calibration", "analysis")
UPKEEP_KINDS = ("backup", "retention", "check-store")
ALWAYS = ("retention", "check-store")
"""Kinds that are accepted even if the disk is nearly full, because they free space or only read."""
RESUMABLE_KINDS = KINDS + UPKEEP_KINDS
"""Kinds created from their stored request alone; each is registered by the service that runs it."""
PERMISSIONS = {
    "experiments": "campaigns",
    "campaign": "campaigns",
    "reprocess": "campaigns",
    "catalogue": "catalogues.build",
    "design": "analyse",
    "calibration": "calibrate",
    "analysis": "analyse",
    "backup": "admin.backup",
    "retention": "admin.retention",
    "check-store": "admin.health",
}
"""Permission needed to start a job of a kind, the same as on the route that first starts it."""
UNKNOWN_KIND = "admin.users"
"""Permission for an unknown kind: an admin permission."""


class Cancelled(Exception):
    """Raised inside a job's work at the next progress report after it was cancelled."""


Progress = Callable[[int, int, str], None]
Work = Callable[[Progress], dict[str, Any]]


class Keep(Protocol):
    """Stores a checkpoint; with a ``session``, in the same transaction as the data it refers to."""

    def __call__(self, checkpoint: dict[str, Any], session: Any = None) -> None: ...


@dataclass(frozen=True)
class Run:
    """Context of resumable work. ``checkpoint``: what the last ``keep`` stored, None on the first run."""

    job_id: int
    request: dict[str, Any]
    checkpoint: dict[str, Any] | None
    progress: Progress
    keep: Keep


Resumable = Callable[[Run], dict[str, Any]]


LEFT_TO_THE_NEXT = "the server stops; it continues with the next start"


class JobService:
    """Runs jobs one at a time on a thread. ``check_room`` raises StoreDown if the disk has no room for a job's results."""

    def __init__(self, database: Database, bus: EventBus, now: Now, check_room: Callable[[str], None]) -> None:
        self._database, self._bus, self._now, self._check_room = database, bus, now, check_room
        self._pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix="job")
        self._cancel: dict[int, threading.Event] = {}
        self._kinds: dict[str, Resumable] = {}
        self._once: dict[str, tuple[str, ...]] = {}
        self._stopping = False
        self._marking = threading.RLock()
        """Makes a check of a job's state and the change that follows from it one step."""
        self.renewals: dict[str, Callable[[], dict[str, Any]]] = {}
        """By kind: returns the parts of a stored request that are refreshed when its job is restarted or resumed, because
        the stored ones may be outdated."""

    def resumable(self, kind: str, work: Resumable, *, once: tuple[str, ...] = ()) -> None:
        """Register work of this kind, one of :data:`RESUMABLE_KINDS`, that survives a crash of the server. ``once``: names in the
        request that hold for one job only; a job started again has None there."""
        self._kinds[kind], self._once[kind] = work, once

    def start(self) -> None:
        """Resume the jobs that the last server left open; jobs that cannot be resumed are closed, keeping their requests."""
        with self._database.unit_of_work() as session:
            left = store.unfinished(session)
        for job in left:
            deaths = job.attempts + (job.state == "running")
            if job.kind not in self._kinds:
                self._fail(job.id, "the server stopped before the end; start it again")
            elif deaths >= MOST_DEATHS:
                self._fail(job.id, f"the server stopped {deaths} times over it; it is not tried again by itself")
            else:
                where = "goes on where it was" if job.checkpoint else "starts anew"
                text = f"the server restarted; it {where}"
                request = {**job.request, **self._fresh(job.kind)}
                self._update(job.id, state="queued", attempts=deaths, text=text, request=request)
                self._queue(job.id, self._kinds[job.kind])

    def interrupt(self) -> None:
        """Cancel every job, also those queued later. Running resumable jobs are stored as queued at once, so that the end of the
        process does not count as a crash. May be called more than once, from any thread."""
        self._stopping = True
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
        """Stop all jobs and wait. Resumable jobs remain open for the next server; the others are cancelled."""
        self.interrupt()
        self._pool.shutdown(wait=True, cancel_futures=True)

    def finish(self) -> None:
        """Wait until all queued jobs have ended; no more can be queued afterwards."""
        self._pool.shutdown(wait=True)

    def submit(self, kind: str, title: str, request: dict[str, Any], work: Work) -> Job:
        """Queue work that is lost if the server stops; return its row at once."""
        job = self._add(kind, title, request)
        self._queue(job.id, lambda run: work(run.progress))
        return job

    def begin(self, kind: str, title: str, request: dict[str, Any], work: Resumable | None = None) -> Job:
        """Queue work of a resumable kind and return its row at once. It is created from ``request`` alone; ``work``: the
        same work if it was already created to validate the request."""
        job = self._add(kind, title, request)
        self._queue(job.id, work or self._kinds[kind])
        return job

    def again(self, job_id: int, *, user: str) -> Job:
        """Start an ended job again from its stored request, on behalf of ``user``. Raises Conflict if its kind does not
        permit that."""
        old = self.get(job_id)
        if not can_start_again(old) or old.kind not in self._kinds:
            raise Conflict(
                "this job cannot be started again",
                expected="an ended job of a kind that is made from its stored request",
                got=f"{old.kind}, {old.state}",
            )
        asker = {"user": user} if "user" in old.request else {}
        once = dict.fromkeys(name for name in self._once[old.kind] if name in old.request)
        return self.begin(old.kind, old.title, {**old.request, **self._fresh(old.kind), **asker, **once})

    def _fresh(self, kind: str) -> dict[str, Any]:
        """Return the current values of the parts of a request that may be outdated."""
        return self.renewals.get(kind, dict)()

    def cancel(self, job_id: int) -> Job:
        """Request a job to end, which it does at its next progress report. Raises Conflict if it has ended."""
        job = self.get(job_id)
        if job.state not in ("queued", "running"):
            raise Conflict("this job has ended", expected="a queued or running job", got=job.state)
        if job_id in self._cancel:
            self._cancel[job_id].set()
        return job

    def get(self, job_id: int) -> Job:
        """Return the job with that id. Raises NotFound."""
        with self._database.unit_of_work() as session:
            return store.get(session, job_id)

    def newest(self, limit: int) -> list[Job]:
        """Return the newest jobs first."""
        with self._database.unit_of_work() as session:
            return store.newest(session, limit)

    def waiting(self) -> int:
        """Number of queued and running jobs."""
        return len(self._cancel)

    # --- running ------------------------------------------------------------------------------------------------

    def _add(self, kind: str, title: str, request: dict[str, Any]) -> Job:
        if kind not in ALWAYS:
            self._check_room("a new job")
        row = Job(
            kind=kind, title=title, state="queued", text="waiting", created=self._now(), request=request, result={}
        )
        row.done = row.total = row.attempts = 0
        with self._database.unit_of_work() as session:
            return store.add(session, row)

    def _queue(self, job_id: int, work: Resumable) -> None:
        cancel = self._cancel[job_id] = threading.Event()
        if self._stopping:
            cancel.set()
        self._bus.publish("job", self.get(job_id))
        self._pool.submit(self._run, job_id, work)

    def _run(self, job_id: int, work: Resumable) -> None:
        cancel, job = self._cancel[job_id], self.get(job_id)

        told_s, last = -math.inf, {"done": job.done, "total": job.total}

        def progress(done: int, total: int, text: str) -> None:
            nonlocal told_s, last
            with self._marking:
                if cancel.is_set():
                    raise Cancelled
                # Work may report thousands of times; a row and a message for each would cost more than the work.
                now_s, last = stopwatch_s(), {"done": done, "total": total}
                if now_s - told_s >= TELL_EVERY_S:
                    told_s = now_s
                    self._update(job_id, state="running", done=done, total=total, text=text)

        def keep(checkpoint: dict[str, Any], session: Any = None) -> None:
            if session is None:
                with self._database.unit_of_work() as own:
                    store.keep(own, job_id, checkpoint)
            else:
                store.keep(session, job_id, checkpoint)

        try:
            progress(job.done, job.total, "started")
            result = work(Run(job_id, dict(job.request), job.checkpoint, progress, keep))
        except Cancelled:
            self._interrupted(job, last)
        except GssError as error:
            self._fail(job_id, str(error))
        except Exception as error:  # a defect in a job must end as a visible failure, never as a silent dead thread
            self._fail(job_id, f"defect in the server: {type(error).__name__}: {error}")
        else:
            values = {"result": result, "checkpoint": None, "finished": self._now(), **last}
            self._update(job_id, state="done", text="done", **values)
        finally:
            self._cancel.pop(job_id, None)

    def _interrupted(self, job: Job, last: dict[str, int]) -> None:
        """Mark a job as cancelled, or as queued if the server is stopping and the next one can resume it."""
        if self._stopping and job.kind in self._kinds:
            self._update(job.id, state="queued", text=LEFT_TO_THE_NEXT, **last)
        else:
            self._update(job.id, state="cancelled", text="cancelled", finished=self._now(), **last)

    def _fail(self, job_id: int, text: str) -> None:
        self._bus.record("job", "warning", f"{self.get(job_id).title}: {text}", job_id=job_id)
        self._update(job_id, state="failed", text=text, finished=self._now())

    def _update(self, job_id: int, **values: Any) -> Job:
        with self._marking, self._database.unit_of_work() as session:
            job = store.get(session, job_id)
            for name, value in values.items():
                setattr(job, name, value)
        self._bus.publish("job", job)
        return job


def can_start_again(job: Job) -> bool:
    """True if the job has ended and its kind is created from the stored request alone."""
    return job.state in ENDED and job.kind in RESUMABLE_KINDS


def permission_of(job: Job) -> str:
    """Return the permission needed to start or end this job; the user who started it may always end it."""
    return PERMISSIONS.get(job.kind, UNKNOWN_KIND)


def started_by(job: Job, user: str) -> bool:
    """True if this user started the job."""
    return job.request.get("user") == user

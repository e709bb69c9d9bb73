"""Long work: queued, running with progress, cancelled when asked, its result kept."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

from gss.domain.errors import Conflict, GssError
from gss.operations.clock import Now, stopwatch_s
from gss.operations.events import EventBus
from gss.store import jobs as store
from gss.store.engine import Database
from gss.store.models import Job

TELL_EVERY_S = 0.1


class Cancelled(Exception):
    """Raised inside a job's work at the next report of progress after somebody cancelled it."""


Progress = Callable[[int, int, str], None]
Work = Callable[[Progress], dict[str, Any]]


class JobService:
    """Runs jobs one at a time on a thread; numpy lets the server breathe meanwhile."""

    def __init__(self, database: Database, bus: EventBus, now: Now) -> None:
        self._database, self._bus, self._now = database, bus, now
        self._pool = ThreadPoolExecutor(max_workers=1, thread_name_prefix="job")
        self._cancel: dict[int, threading.Event] = {}

    def start(self) -> None:
        """Close what the last server left open: its work is gone, and the request is kept to start it again."""
        with self._database.unit_of_work() as session:
            for job in store.unfinished(session):
                job.state, job.finished, job.text = (
                    "failed",
                    self._now(),
                    "the server stopped before the end; start it again",
                )

    def stop(self) -> None:
        """Cancel everything and wait."""
        for event in self._cancel.values():
            event.set()
        self._pool.shutdown(wait=True, cancel_futures=True)

    def submit(self, kind: str, title: str, request: dict[str, Any], work: Work) -> Job:
        """Queue work; its row comes back at once."""
        with self._database.unit_of_work() as session:
            job = store.add(
                session,
                Job(
                    kind=kind,
                    title=title,
                    state="queued",
                    done=0,
                    total=0,
                    text="waiting",
                    created=self._now(),
                    request=request,
                    result={},
                ),
            )
        self._cancel[job.id] = threading.Event()
        self._bus.publish("job", job)
        self._pool.submit(self._run, job.id, work)
        return job

    def cancel(self, job_id: int) -> Job:
        """Ask a job to end; it does at its next report of progress."""
        job = self.get(job_id)
        if job.state not in ("queued", "running"):
            raise Conflict("this job has ended", expected="a queued or running job", got=job.state)
        if job_id in self._cancel:
            self._cancel[job_id].set()
        return job

    def get(self, job_id: int) -> Job:
        """The job of that id."""
        with self._database.unit_of_work() as session:
            return store.get(session, job_id)

    def newest(self, limit: int) -> list[Job]:
        """Newest jobs first."""
        with self._database.unit_of_work() as session:
            return store.newest(session, limit)

    def _run(self, job_id: int, work: Work) -> None:
        cancel = self._cancel[job_id]

        told_s, last = -math.inf, {"done": 0, "total": 0}

        def progress(done: int, total: int, text: str) -> None:
            nonlocal told_s, last
            if cancel.is_set():
                raise Cancelled
            # Work may report thousands of times; a row and a message for each would cost more than the work.
            now_s, last = stopwatch_s(), {"done": done, "total": total}
            if now_s - told_s >= TELL_EVERY_S:
                told_s = now_s
                self._update(job_id, state="running", done=done, total=total, text=text)

        try:
            progress(0, 0, "started")
            result = work(progress)
        except Cancelled:
            self._update(job_id, state="cancelled", text="cancelled", finished=self._now(), **last)
        except GssError as error:
            self._fail(job_id, str(error))
        except Exception as error:  # a defect in a job must end as a visible failure, never as a silent dead thread
            self._fail(job_id, f"defect in the server: {type(error).__name__}: {error}")
        else:
            self._update(job_id, state="done", text="done", result=result, finished=self._now(), **last)
        finally:
            self._cancel.pop(job_id, None)

    def _fail(self, job_id: int, text: str) -> None:
        self._bus.record("job", "warning", f"{self.get(job_id).title}: {text}", job_id=job_id)
        self._update(job_id, state="failed", text=text, finished=self._now())

    def _update(self, job_id: int, **values: Any) -> Job:
        with self._database.unit_of_work() as session:
            job = store.get(session, job_id)
            for name, value in values.items():
                setattr(job, name, value)
        self._bus.publish("job", job)
        return job

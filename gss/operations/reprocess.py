"""Run a chain over many stored frames: a job on worker processes, with progress, cancel, and resume by doing only the rest.

Workers get pixels and give back plain values; the database is written here only, one transaction per batch, so that a job
that ends anywhere leaves whole solutions and nothing else. The same frames, chain and version give the same values on any
number of workers.
"""

from __future__ import annotations

import math
import multiprocessing
from collections.abc import Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass, replace
from itertools import islice
from typing import Any

import numpy as np

from gss import __version__
from gss.domain.errors import BadInput, GssError
from gss.domain.stars import StarTable
from gss.operations.clock import Now, stopwatch_s
from gss.operations.jobs import JobService, Progress
from gss.operations.solution_rows import solution_values
from gss.operations.solve import CHAINS, Solver, SolverCache, SolveRequest
from gss.store import frames as store
from gss.store.blobs import BlobStore
from gss.store.engine import Database
from gss.store.models import Frame, Job, Solution

BATCH = 8
WORKERS = 2
AHEAD = 2
"""Batches per worker that wait in line."""
MOST_FRAMES = 100_000


@dataclass(frozen=True)
class Reprocessing:
    """Which frames and how. ``frame_ids`` empty: every complete frame that fits ``filters`` (as the frame list takes them).
    ``profile``: camera of frames that have none; without it those are solved blind (reference chain only).
    ``again``: also frames that this chain and version have solved."""

    chain: str
    frame_ids: tuple[int, ...] = ()
    profile: str | None = None
    again: bool = False


@dataclass(frozen=True)
class Task:
    """What a worker needs of one frame."""

    frame_id: int
    sha256: str
    dtype: str
    rows: int
    columns: int
    profile: str | None
    truth: list[Any] | None


class ReprocessService:
    """Starts reprocessing jobs."""

    def __init__(
        self, database: Database, blobs_url: str, jobs: JobService, now: Now, epoch_jyear: float, workers: int = WORKERS
    ) -> None:
        self._database, self._blobs_url, self._jobs, self._now = database, blobs_url, jobs, now
        self._epoch_jyear, self._workers = epoch_jyear, workers

    def start(self, wanted: Reprocessing, *, user: str, **filters: Any) -> Job:
        """Queue the job. BadInput where there is nothing to do or the chain is unknown."""
        if wanted.chain not in CHAINS:
            raise BadInput("unknown chain", expected=" | ".join(CHAINS), got=wanted.chain)
        tasks = self.tasks(wanted, **filters)
        if not tasks:
            raise BadInput(
                "no frame to run",
                expected="at least one complete frame without a result of this chain and version",
                hint="run again asks for all of them",
            )
        request = {
            "chain": wanted.chain,
            "version": __version__,
            "frames": len(tasks),
            "again": wanted.again,
            "user": user,
        }
        title = f"{wanted.chain} on {len(tasks)} frames"
        return self._jobs.submit("reprocess", title, request, lambda progress: self.work(wanted, tasks, progress))

    def tasks(self, wanted: Reprocessing, **filters: Any) -> list[Task]:
        """What is to be done, oldest frame first."""
        with self._database.unit_of_work() as session:
            if wanted.frame_ids:
                frames = [store.get(session, i) for i in wanted.frame_ids]
            else:
                frames = store.page(session, MOST_FRAMES, 0, **filters)[1]
            done = set() if wanted.again else store.solved_by(session, wanted.chain, __version__)
        rows = sorted((f for f in frames if f.complete and f.id not in done), key=lambda f: f.id)
        return [_task(f, wanted.profile) for f in rows]

    def work(self, wanted: Reprocessing, tasks: Sequence[Task], progress: Progress) -> dict[str, Any]:
        """Do it; the job's result is a count of outcomes and verdicts."""
        counts: dict[str, int] = {}
        started_s, done = stopwatch_s(), 0
        context = multiprocessing.get_context("spawn")
        initial = (self._blobs_url, self._epoch_jyear, wanted.chain)
        pool = ProcessPoolExecutor(self._workers, context, _prepare, initial)
        try:
            for rows in _in_batches(pool, tasks, self._workers * AHEAD):
                self._keep(rows)
                for row in rows:
                    for key in (row["outcome"], row.get("verdict")):
                        if key:
                            counts[key] = counts.get(key, 0) + 1
                done += len(rows)
                rate = done / max(1e-3, stopwatch_s() - started_s)
                progress(done, len(tasks), f"{done} of {len(tasks)} frames, {rate:.0f} frames/s")
        except BrokenProcessPool as error:
            raise GssError(
                "a worker process died", got=str(error), hint="what was done is kept; start it again for the rest"
            ) from error
        finally:
            pool.shutdown(wait=True, cancel_futures=True)
        elapsed_s = stopwatch_s() - started_s
        return {"frames": done, "counts": counts, "elapsed_s": round(elapsed_s, 3)}

    def _keep(self, rows: Sequence[dict[str, Any]]) -> None:
        created = self._now()
        with self._database.unit_of_work() as session:
            for row in rows:
                store.add_solution(session, Solution(origin="ground", created=created, **row))


def _task(frame: Frame, profile_name: str | None) -> Task:
    return Task(
        frame.id, frame.sha256, frame.dtype, frame.rows, frame.columns, frame.profile or profile_name, frame.truth
    )


def _in_batches(pool: ProcessPoolExecutor, tasks: Sequence[Task], ahead: int) -> Iterator[list[dict[str, Any]]]:
    """Results as they come; only so many batches wait in the pool, so that a cancelled job ends at once."""
    waiting = iter(tasks)
    running: set[Future[list[dict[str, Any]]]] = set()
    while True:
        while len(running) < ahead and (batch := list(islice(waiting, BATCH))):
            running.add(pool.submit(run_batch, batch))
        if not running:
            return
        finished, running = wait(running, return_when=FIRST_COMPLETED)
        for future in finished:
            yield future.result()


# --- in the worker --------------------------------------------------------------------------------------------------


@dataclass
class _Worker:
    """What one worker process keeps from batch to batch."""

    blobs: BlobStore
    solver: Solver
    stars: StarTable
    chain: str


_worker: _Worker | None = None


def _prepare(blobs_url: str, epoch_jyear: float, chain: str) -> None:
    global _worker
    cache = SolverCache()
    _worker = _Worker(BlobStore(blobs_url), Solver(cache, stopwatch_s, epoch_jyear), cache.stars(epoch_jyear), chain)


def run_batch(tasks: Sequence[Task]) -> list[dict[str, Any]]:
    """One row of values per task; a frame that cannot be run gives "none" with the reason."""
    assert _worker is not None  # noqa: S101 - the pool has called _prepare
    return [_run(_worker, task) for task in tasks]


def _run(worker: _Worker, task: Task) -> dict[str, Any]:
    try:
        data = np.frombuffer(worker.blobs.get(task.sha256), np.dtype(task.dtype))
        pixels = data.reshape(task.rows, task.columns)
        request = SolveRequest(chain=worker.chain, profile=task.profile, blind=task.profile is None)
        result = worker.solver.solve(pixels, request)
        result = replace(result, timing_s={k: v for k, v in result.timing_s.items() if math.isfinite(v)})
    except GssError as error:
        return {"frame_id": task.frame_id, "chain": worker.chain, "version": __version__, "outcome": "none"} | {
            "reason": str(error)
        }
    return {"frame_id": task.frame_id} | solution_values(result, worker.stars, task.profile, task.truth)

"""Run a chain over many stored frames: a job on worker processes, with progress, cancel, and resume by doing only the rest.

Workers get pixels and give back plain values; the database is written here only, one transaction per batch, so that a job
that ends anywhere leaves whole solutions and nothing else. The same frames, chain and version give the same values on any
number of workers. What the overlays draw beside stars and regions follows from attitude and camera, and is made when asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from itertools import islice
from typing import Any

from gss import __version__
from gss.domain.errors import BadInput, GssError
from gss.domain.profiles import CameraProfile
from gss.operations.clock import Now, stopwatch_s
from gss.operations.frames.observer import observer_of_frame
from gss.operations.frames.solve import CHAINS
from gss.operations.jobs import JobService, Progress
from gss.operations.studies.reprocess_worker import Order, Task, run_batch
from gss.operations.studies.warm_pool import WarmPool
from gss.pipeline.chains import reference
from gss.store import frames as store
from gss.store.engine import Database
from gss.store.models import Frame, Job

BATCH = 8
WORKERS = 2
AHEAD = 3
"""Batches per worker that wait in line."""
TELL_S = 0.25
"""Between two reports of progress."""
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


class ReprocessService:
    """Starts reprocessing jobs."""

    def __init__(
        self,
        database: Database,
        blobs_url: str,
        jobs: JobService,
        now: Now,
        epoch_jyear: float,
        workers: int = WORKERS,
        profiles: Callable[[], Mapping[str, CameraProfile]] = dict,
    ) -> None:
        self._database, self._blobs_url, self._jobs, self._now = database, blobs_url, jobs, now
        self._epoch_jyear, self._profiles = epoch_jyear, profiles
        self._pool = WarmPool(workers)

    def stop(self) -> None:
        """End the worker processes."""
        self._pool.stop()

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
        return [_task(f, wanted) for f in rows]

    def work(self, wanted: Reprocessing, tasks: Sequence[Task], progress: Progress) -> dict[str, Any]:
        """Do it; the job's result is a count of outcomes and verdicts."""
        counts: dict[str, int] = {}
        started_s, done, told_s = stopwatch_s(), 0, 0.0
        order = Order(self._blobs_url, self._epoch_jyear, wanted.chain, dict(self._profiles()))
        try:
            with self._pool.borrowed() as pool:
                for rows in _in_batches(pool, order, tasks, self._pool.workers * AHEAD):
                    self._keep(rows)
                    for row in rows:
                        # The verdict "none" says no more than the outcome "none".
                        for key in {row["outcome"], row.get("verdict")}:
                            if key:
                                counts[key] = counts.get(key, 0) + 1
                    done += len(rows)
                    elapsed_s = stopwatch_s() - started_s
                    if done == len(tasks) or elapsed_s - told_s > TELL_S or done == len(rows):
                        told_s = elapsed_s
                        rate = done / max(1e-3, elapsed_s)
                        progress(done, len(tasks), f"{done} of {len(tasks)} frames, {rate:.0f} frames/s")
        except BrokenProcessPool as error:
            raise GssError(
                "a worker process died", got=str(error), hint="what was done is kept; start it again for the rest"
            ) from error
        elapsed_s = stopwatch_s() - started_s
        return {"frames": done, "counts": counts, "elapsed_s": round(elapsed_s, 3)}

    def _keep(self, rows: Sequence[dict[str, Any]]) -> None:
        common = {"origin": "ground", "created": self._now()}
        with self._database.unit_of_work() as session:
            store.add_solutions(session, [common | row for row in rows])


def _task(frame: Frame, wanted: Reprocessing) -> Task:
    """What the page's own run of that chain would be given."""
    observer = observer_of_frame(frame) if wanted.chain == reference.NAME else None
    named = frame.profile or wanted.profile
    return Task(
        *(
            frame.id,
            frame.sha256,
            frame.dtype,
            frame.rows,
            frame.columns,
            named,
            frame.truth,
            observer,
            frame.exposure_s,
        )
    )


def _in_batches(
    pool: ProcessPoolExecutor, order: Order, tasks: Sequence[Task], ahead: int
) -> Iterator[list[dict[str, Any]]]:
    """Results as they come, what is ready at once together; only so many batches wait in the pool, so that a cancelled job ends
    at once."""
    waiting = iter(tasks)
    running: set[Future[list[dict[str, Any]]]] = set()
    while True:
        while len(running) < ahead and (batch := list(islice(waiting, BATCH))):
            running.add(pool.submit(run_batch, order, batch))
        if not running:
            return
        finished, running = wait(running, return_when=FIRST_COMPLETED)
        yield [row for future in finished for row in future.result()]

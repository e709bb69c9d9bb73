"""Runs a chain over many stored frames as a resumable job on worker processes or a cluster, with progress and cancelling.

Workers receive blob keys and return plain values; only this process writes the database: each batch's results and the job's
checkpoint in one transaction, in the order of the frames. An interrupted job therefore leaves only complete solutions, and the
next server continues after them. The same frames, chain and version give the same values on any number of workers. Overlays
other than stars and regions follow from attitude and camera, and are computed on request.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import islice
from typing import Any

from gss import __version__
from gss.domain.errors import BadInput, Conflict
from gss.domain.profiles import CameraProfile
from gss.domain.words import counted
from gss.operations.clock import Now, stopwatch_s
from gss.operations.frames.observer import observer_of_frame
from gss.operations.frames.solve import CHAINS
from gss.operations.jobs import JobService, Keep, Progress, Run
from gss.operations.studies.executor import Executor
from gss.operations.studies.reprocess_worker import Order, Task, run_item
from gss.pipeline.chains import reference
from gss.store import frames as store
from gss.store.engine import Database
from gss.store.models import Frame, Job

KIND = "reprocess"
BATCH = 8
WORKERS = 2
TELL_S = 0.25
"""Interval between progress reports."""
MOST_FRAMES = 100_000


@dataclass(frozen=True)
class Reprocessing:
    """Which frames to run and how. ``frame_ids`` empty: every complete frame that matches ``filters`` (as in the frame
    list). ``profile``: camera of frames that have none; without it those are solved blind (reference chain only). ``again``:
    include frames that this chain and version have solved."""

    chain: str
    frame_ids: tuple[int, ...] = ()
    profile: str | None = None
    again: bool = False


@dataclass
class Done:
    """Progress of a job: frames with a result, numbers of outcomes and verdicts, the last frame. Its plain values are the
    job's checkpoint."""

    frames: int = 0
    last_id: int = 0
    elapsed_s: float = 0.0
    counts: dict[str, int] | None = None

    def count(self, rows: Sequence[Mapping[str, Any]]) -> None:
        """Add a batch."""
        self.counts = self.counts or {}
        for row in rows:
            # A set, so that the verdict "none" and the outcome "none" count once.
            for key in {row["outcome"], row.get("verdict")}:
                if key:
                    self.counts[key] = self.counts.get(key, 0) + 1
        self.frames, self.last_id = self.frames + len(rows), rows[-1]["frame_id"]


class ReprocessService:
    """Starts reprocessing jobs. Results are stored in addition to each frame's operational ground result; they become
    operational only for frames that have none, with ``operational_chain`` and the frame's camera."""

    def __init__(
        self,
        database: Database,
        blobs_url: str,
        jobs: JobService,
        now: Now,
        epoch_jyear: float,
        executor: Executor,
        operational_chain: str,
        profiles: Callable[[], Mapping[str, CameraProfile]] = dict,
    ) -> None:
        self._database, self._blobs_url, self._jobs, self._now = database, blobs_url, jobs, now
        self._epoch_jyear, self._profiles, self._executor = epoch_jyear, profiles, executor
        self._operational_chain = operational_chain
        jobs.resumable(KIND, self._resume)

    def start(self, wanted: Reprocessing, *, user: str, **filters: Any) -> Job:
        """Queue the job. Raises BadInput if there is no frame to run or the chain is unknown."""
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
            "frame_ids": list(wanted.frame_ids),
            "profile": wanted.profile,
            "filters": filters,
            "up_to": tasks[-1].frame_id,
            "epoch_jyear": self._epoch_jyear,
        }
        return self._jobs.begin(KIND, f"{wanted.chain} on {counted(len(tasks), 'frame')}", request)

    def tasks(self, wanted: Reprocessing, **filters: Any) -> list[Task]:
        """Return the tasks, oldest frame first."""
        with self._database.unit_of_work() as session:
            if wanted.frame_ids:
                frames = [store.get(session, i) for i in wanted.frame_ids]
            else:
                frames = store.page(session, MOST_FRAMES, 0, **filters)[1]
            done = set() if wanted.again else store.solved_by(session, wanted.chain, __version__)
        rows = sorted(
            (f for f in frames if f.complete and f.pixels_removed is None and f.id not in done), key=lambda f: f.id
        )
        return [_task(f, wanted) for f in rows]

    def _resume(self, run: Run) -> dict[str, Any]:
        """Continue a job from its stored request, after its checkpoint. Raises Conflict if the program's version has
        changed."""
        request = run.request
        if request["version"] != __version__:
            raise Conflict(
                "the program was changed since this job began",
                expected=request["version"],
                got=__version__,
                hint="what was done is kept; start it anew",
            )
        wanted = Reprocessing(request["chain"], tuple(request["frame_ids"]), request["profile"], request["again"])
        done = Done(**run.checkpoint) if run.checkpoint else Done()
        tasks = [
            task
            for task in self.tasks(wanted, **request["filters"])
            if done.last_id < task.frame_id <= request["up_to"]
        ]
        return self.work(wanted, tasks, run.progress, done, run.keep, request["epoch_jyear"])

    def work(
        self,
        wanted: Reprocessing,
        tasks: Sequence[Task],
        progress: Progress,
        done: Done | None = None,
        keep: Keep | None = None,
        epoch_jyear: float | None = None,
    ) -> dict[str, Any]:
        """Run the tasks. Return the job's result: counts of outcomes and verdicts. ``done``: progress before a restart."""
        done = done or Done()
        total, before_s, started_s, told_s = done.frames + len(tasks), done.elapsed_s, stopwatch_s(), 0.0
        at_first = done.frames
        order = Order(self._blobs_url, epoch_jyear or self._epoch_jyear, wanted.chain, dict(self._profiles()))

        def tell(_share: float = 0.0) -> None:
            rate = (done.frames - at_first) / max(1e-3, stopwatch_s() - started_s)
            progress(done.frames, total, f"{done.frames} of {total} frames, {rate:.0f} frames/s")

        with closing(self._executor.in_order(run_item, _batches(order, tasks), tell)) as results:
            for rows in results:
                done.count(rows)
                elapsed_s = stopwatch_s() - started_s
                done.elapsed_s = round(before_s + elapsed_s, 3)
                self._keep(rows, done, keep)
                if done.frames == total or elapsed_s - told_s > TELL_S or done.frames == at_first + len(rows):
                    told_s = elapsed_s
                    tell()
        return {"frames": done.frames, "counts": done.counts or {}, "elapsed_s": done.elapsed_s}

    def _keep(self, rows: Sequence[dict[str, Any]], done: Done, keep: Keep | None) -> None:
        common = {"origin": "ground", "created": self._now()}
        with self._database.unit_of_work() as session:
            store.add_solutions(session, [common | row for row in rows])
            store.pin_missing(session, [row["frame_id"] for row in rows], self._operational_chain)
            if keep is not None:
                keep(vars(done) | {}, session)


def _task(frame: Frame, wanted: Reprocessing) -> Task:
    """Return a task with the same inputs as a single run of that chain from the page."""
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


def _batches(order: Order, tasks: Sequence[Task]) -> Iterator[tuple[Order, list[Task]]]:
    waiting = iter(tasks)
    while batch := list(islice(waiting, BATCH)):
        yield order, batch

"""Runs a chain over many stored frames as a resumable job on worker processes or a cluster, with progress and cancelling.

Workers receive blob keys and return plain values; only this process writes the database: each batch's results and the job's
checkpoint in one transaction, in the order of the frames. An interrupted job therefore leaves only complete solutions, and the
next server continues after them. The same frames, chain and version give the same values on any number of workers. Overlays
other than stars and regions follow from attitude and camera, and are computed on request.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import islice
from typing import TypedDict

from pydantic import Field

from gss import __version__
from gss.domain.errors import BadInput, Conflict
from gss.domain.json_object import JsonObject
from gss.domain.words import counted
from gss.instruments.registry import Registry
from gss.operations.clock import Now, stopwatch_s
from gss.operations.frames.observer import epoch_of_frame, observer_of_frame
from gss.operations.frames.solve import CHAINS, options_of
from gss.operations.jobs import JobKind, JobRequest, JobResult, JobRun, JobService, Keep, Progress
from gss.operations.requests import ChainOptions, Id, Request
from gss.operations.studies.camera_book import CameraBook
from gss.operations.studies.executor import Executor
from gss.operations.studies.reprocess_worker import BatchSettings, Task, TaskResult, run_item
from gss.pipeline.chains import reference
from gss.pipeline.chains.options import as_text
from gss.store import frames as store
from gss.store.engine import Database
from gss.store.models import Frame, Job

KIND = "reprocess"
BATCH = 8
WORKERS = 2
REPORT_EVERY_S = 0.25
"""Interval between progress reports."""
MAX_FRAMES = 100_000


class ReprocessRequest(Request):
    """Frames to reprocess, by id or by filter. ``profile``: camera of frames that have none; without it those are solved blind
    (reference chain only). ``again``: include frames that this version of the chain has already solved. ``options``: constants
    of the chain to change."""

    chain: str = Field(min_length=1, max_length=30)
    frame_ids: list[Id] = Field(default_factory=list, max_length=MAX_FRAMES)
    source: str = Field(default="", max_length=10)
    contact: Id | None = None
    profile: str | None = Field(default=None, max_length=40)
    again: bool = False
    options: ChainOptions = Field(default_factory=dict)


@dataclass(frozen=True)
class ReprocessJob(JobRequest):
    """Frames up to number ``up_to`` to reprocess with this version of the program; ``frames``: how many they were."""

    asked: ReprocessRequest
    version: str
    frames: int
    up_to: int
    epoch_jyear: float


def _of_version_0_4(stored: JsonObject) -> JsonObject:
    """Convert a stored request of version 0.4, which was flat."""
    if "asked" in stored:
        return stored
    filters = {"source": stored["filters"].get("source", ""), "contact": stored["filters"].get("contact_id")}
    spec = {name: stored[name] for name in ("chain", "frame_ids", "profile", "again")} | filters
    return {"asked": spec} | {n: stored[n] for n in ("user", "version", "frames", "up_to", "epoch_jyear")}


@dataclass
class Done:
    """Progress of a job: frames with a result, numbers of outcomes and verdicts, the last frame. Its plain values are the
    job's checkpoint."""

    frames: int = 0
    last_id: int = 0
    elapsed_s: float = 0.0
    counts: dict[str, int] | None = None

    def count(self, rows: Sequence[TaskResult]) -> None:
        """Add a batch."""
        self.counts = self.counts or {}
        for row in rows:
            # A set, so that the verdict "none" and the outcome "none" count once.
            for key in {row["outcome"], row.get("verdict")}:
                if key:
                    self.counts[key] = self.counts.get(key, 0) + 1
        self.frames, self.last_id = self.frames + len(rows), rows[-1]["frame_id"]


class ReprocessResult(TypedDict):
    """Result of a job: frames, and numbers of outcomes and verdicts."""

    frames: int
    counts: dict[str, int]
    elapsed_s: float


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
        book: CameraBook,
        instruments: Registry,
    ) -> None:
        self._database, self._blobs_url, self._jobs, self._now = database, blobs_url, jobs, now
        self._epoch_jyear, self._book, self._executor = epoch_jyear, book, executor
        self._instruments = instruments
        self._operational_chain = operational_chain
        jobs.register(JobKind(KIND, ReprocessJob, self._resume, older=_of_version_0_4))

    def start(self, spec: ReprocessRequest, *, user: str) -> Job:
        """Queue the job. Raises BadInput if there is no frame to run, the chain is unknown or it rejects a changed constant."""
        if spec.chain not in CHAINS:
            raise BadInput("unknown chain", expected=" | ".join(CHAINS), got=spec.chain)
        tasks = self.tasks(spec)
        if not tasks:
            raise BadInput(
                "no frame to run",
                expected="at least one complete frame without a result of this chain and version",
                hint="select Run again to include all of them",
            )
        for profile in {task.profile for task in tasks if task.profile is not None} if spec.options else ():
            options_of(spec.chain, self._book.profile(profile), spec.options)
        job = ReprocessJob(spec, __version__, len(tasks), tasks[-1].frame_id, self._epoch_jyear, user=user)
        changed = f" with {counted(len(spec.options), 'changed constant')}" if spec.options else ""
        return self._jobs.begin(KIND, f"{spec.chain} on {counted(len(tasks), 'frame')}{changed}", job)

    def tasks(self, request: ReprocessRequest) -> list[Task]:
        """Return the tasks, oldest frame first."""
        with self._database.unit_of_work() as session:
            if request.frame_ids:
                frames = [store.get(session, i) for i in request.frame_ids]
            else:
                frames = store.page(session, MAX_FRAMES, 0, source=request.source, contact_id=request.contact)[1]
            done = (
                set()
                if request.again
                else store.solved_by(session, request.chain, __version__, as_text(request.options))
            )
        rows = sorted(
            (f for f in frames if f.complete and f.pixels_removed is None and f.id not in done), key=lambda f: f.id
        )
        return [_task(f, request) for f in rows]

    def _resume(self, job: ReprocessJob, run: JobRun) -> JobResult:
        """Continue a job from its stored request, after its checkpoint. Raises Conflict if the program's version has
        changed."""
        if job.version != __version__:
            raise Conflict(
                "the software version changed since this job started",
                expected=job.version,
                got=__version__,
                hint="finished work is kept; start a new job",
            )
        done = Done(**run.checkpoint) if run.checkpoint else Done()
        tasks = [task for task in self.tasks(job.asked) if done.last_id < task.frame_id <= job.up_to]
        return self.work(job.asked, tasks, run.progress, done, run.keep, job.epoch_jyear)

    def work(
        self,
        request: ReprocessRequest,
        tasks: Sequence[Task],
        progress: Progress,
        done: Done | None = None,
        keep: Keep | None = None,
        epoch_jyear: float | None = None,
    ) -> ReprocessResult:
        """Run the tasks. Return the job's result: counts of outcomes and verdicts. ``done``: progress before a restart."""
        done = done or Done()
        total, before_s, started_s, reported_s = done.frames + len(tasks), done.elapsed_s, stopwatch_s(), 0.0
        at_first = done.frames
        epoch, documented = epoch_jyear or self._epoch_jyear, self._instruments.cameras()
        options = tuple(request.options.items())
        order = BatchSettings(self._blobs_url, epoch, request.chain, self._book.profiles(), documented, options)

        def report(_share: float = 0.0) -> None:
            rate = (done.frames - at_first) / max(1e-3, stopwatch_s() - started_s)
            progress(done.frames, total, f"{done.frames} of {total} frames, {rate:.0f} frames/s")

        with closing(self._executor.in_order(run_item, _batches(order, tasks), report)) as results:
            for rows in results:
                done.count(rows)
                elapsed_s = stopwatch_s() - started_s
                done.elapsed_s = round(before_s + elapsed_s, 3)
                self._keep(rows, done, keep)
                if (
                    done.frames == total
                    or elapsed_s - reported_s > REPORT_EVERY_S
                    or done.frames == at_first + len(rows)
                ):
                    reported_s = elapsed_s
                    report()
        return {"frames": done.frames, "counts": done.counts or {}, "elapsed_s": done.elapsed_s}

    def _keep(self, rows: Sequence[TaskResult], done: Done, keep: Keep | None) -> None:
        common: dict[str, object] = {"origin": "ground", "created": self._now()}
        with self._database.unit_of_work() as session:
            store.add_solutions(session, [{**common, **row} for row in rows])
            store.pin_missing(session, [row["frame_id"] for row in rows], self._operational_chain)
            if keep is not None:
                keep(vars(done) | {}, session)


def _task(frame: Frame, request: ReprocessRequest) -> Task:
    """Return a task with the same inputs as a single run of that chain from the page."""
    observer = observer_of_frame(frame) if request.chain == reference.NAME else None
    return Task(
        frame.id,
        frame.sha256,
        frame.dtype,
        frame.rows,
        frame.columns,
        profile=frame.profile or request.profile,
        truth=frame.truth,
        observer=observer,
        exposure_s=frame.exposure_s,
        epoch_jyear=epoch_of_frame(frame),
    )


def _batches(order: BatchSettings, tasks: Sequence[Task]) -> Iterator[tuple[BatchSettings, list[Task]]]:
    waiting = iter(tasks)
    while batch := list(islice(waiting, BATCH)):
        yield order, batch

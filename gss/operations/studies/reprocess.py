"""Runs a chain over many stored frames as a resumable job on worker processes or a cluster, with progress and
cancelling.

Workers receive blob keys and return plain values. Only this process writes the database: it stores the results of each
batch and the checkpoint of the job in one transaction, in the order of the frames. An interrupted job therefore leaves
only complete solutions, and continues with the next frame when the server restarts. The same frames, chain and version
give the same values on any number of workers. Overlays other than stars and regions are derived from attitude and
camera, and are computed on request.
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
from gss.operations.frames.frame_values import dark_columns_of
from gss.operations.frames.observer import epoch_of_frame, observer_of_frame
from gss.operations.frames.solve import CHAINS, options_of
from gss.operations.jobs import JobKind, JobRequest, JobResult, JobRun, JobService, Keep, Progress
from gss.operations.requests import ChainOptions, Id, Request
from gss.operations.studies.camera_book import CameraBook
from gss.operations.studies.executor import Executor
from gss.operations.studies.reprocess_worker import NOT_PROCESSED, BatchSettings, Task, TaskResult, run_item
from gss.pipeline.chains import reference
from gss.pipeline.chains.options import as_text
from gss.store import frames as store
from gss.store.engine import Database
from gss.store.models import Frame, Job

KIND = "reprocess"
BATCH = 16
WORKERS = 2
REPORT_EVERY_S = 0.25
"""Interval between progress reports."""
MAX_FRAMES = 100_000


class ReprocessRequest(Request):
    """Frames to reprocess, by id or by filter. ``profile``: camera for frames without a camera; if it is missing, these
    frames are solved blind (reference chain only). ``again``: include frames that already have a result of this version
    of the chain. ``options``: constants of the chain to change."""

    chain: str = Field(min_length=1, max_length=30)
    frame_ids: list[Id] = Field(default_factory=list, max_length=MAX_FRAMES)
    source: str = Field(default="", max_length=10)
    contact: Id | None = None
    profile: str | None = Field(default=None, max_length=40)
    again: bool = False
    options: ChainOptions = Field(default_factory=dict)


@dataclass(frozen=True)
class ReprocessJob(JobRequest):
    """Job request of a reprocessing. ``version``: version of the program; ``frames``: number of frames; ``up_to``: id
    of the last frame."""

    asked: ReprocessRequest
    version: str
    frames: int
    up_to: int
    epoch_jyear: float


def _of_version_0_4(stored: JsonObject) -> JsonObject:
    """Convert a request stored by version 0.4, which was not nested."""
    if "asked" in stored:
        return stored
    filters = {"source": stored["filters"].get("source", ""), "contact": stored["filters"].get("contact_id")}
    spec = {name: stored[name] for name in ("chain", "frame_ids", "profile", "again")} | filters
    return {"asked": spec} | {n: stored[n] for n in ("user", "version", "frames", "up_to", "epoch_jyear")}


@dataclass
class ReprocessProgress:
    """Progress of a job. ``frames``: number of frames with an outcome; ``last_id``: id of the last of these frames;
    ``counts``: numbers of outcomes and verdicts. Its plain values are the checkpoint of the job."""

    frames: int = 0
    last_id: int = 0
    elapsed_s: float = 0.0
    counts: dict[str, int] | None = None

    def count(self, rows: Sequence[TaskResult]) -> None:
        """Count the results of a batch."""
        self.counts = self.counts or {}
        for row in rows:
            # A set is used because the verdict "none" and the outcome "none" must be counted only once.
            for key in {row["outcome"], row.get("verdict")}:
                if key:
                    self.counts[key] = self.counts.get(key, 0) + 1
        self.frames, self.last_id = self.frames + len(rows), rows[-1]["frame_id"]


class ReprocessResult(TypedDict):
    """Result of a job. ``frames``: number of frames; ``counts``: numbers of outcomes and verdicts."""

    frames: int
    counts: dict[str, int]
    elapsed_s: float


class ReprocessService:
    """Starts reprocessing jobs. Results are stored in addition to the operational ground result of each frame. A result
    of ``operational_chain`` with the frame's camera becomes operational only if the frame has no operational result."""

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
        """Queue the job. Raises BadInput if there is no frame to run, the chain is unknown, or the chain rejects a
        changed constant."""
        if spec.chain not in CHAINS:
            raise BadInput("unknown chain", expected=" | ".join(CHAINS), got=spec.chain)
        tasks = self.tasks(spec)
        if not tasks:
            raise BadInput(
                "no frame to run",
                expected="at least one complete frame without a result of this chain and version",
                hint="include frames that already have a result of this version",
            )
        for profile in {task.profile for task in tasks if task.profile is not None} if spec.options else ():
            options_of(spec.chain, self._book.profile(profile), spec.options)
        job = ReprocessJob(spec, __version__, len(tasks), tasks[-1].frame_id, self._epoch_jyear, user=user)
        changes_text = f" with {counted(len(spec.options), 'changed constant')}" if spec.options else ""
        return self._jobs.begin(KIND, f"{spec.chain} on {counted(len(tasks), 'frame')}{changes_text}", job)

    def tasks(self, request: ReprocessRequest) -> list[Task]:
        """Return the tasks, oldest frame first."""
        with self._database.unit_of_work() as session:
            if request.frame_ids:
                frames = [store.get(session, i) for i in request.frame_ids]
            else:
                frames = store.page(session, MAX_FRAMES, 0, source=request.source, contact_id=request.contact)[1]
            solved_ids = (
                set()
                if request.again
                else store.solved_by(session, request.chain, __version__, as_text(request.options))
            )
        rows = sorted(
            (f for f in frames if f.complete and f.pixels_removed is None and f.id not in solved_ids),
            key=lambda f: f.id,
        )
        return [_task(f, request) for f in rows]

    def _resume(self, job: ReprocessJob, run: JobRun) -> JobResult:
        """Run a job from its stored request, starting after its checkpoint. Raises Conflict if the version of the
        program has changed."""
        if job.version != __version__:
            raise Conflict(
                "the software version changed since this job started",
                expected=job.version,
                got=__version__,
                hint="finished work is kept; start a new job",
            )
        done = ReprocessProgress(**run.checkpoint) if run.checkpoint else ReprocessProgress()
        tasks = [task for task in self.tasks(job.asked) if done.last_id < task.frame_id <= job.up_to]
        return self.work(job.asked, tasks, run.progress, done, run.keep, job.epoch_jyear)

    def work(
        self,
        request: ReprocessRequest,
        tasks: Sequence[Task],
        progress: Progress,
        done: ReprocessProgress | None = None,
        keep: Keep | None = None,
        epoch_jyear: float | None = None,
    ) -> ReprocessResult:
        """Run the tasks and return the result of the job. ``done``: progress before a restart."""
        done = done or ReprocessProgress()
        total, before_s, started_s, reported_s = done.frames + len(tasks), done.elapsed_s, stopwatch_s(), 0.0
        frames_before = done.frames
        epoch, documented = epoch_jyear or self._epoch_jyear, self._instruments.cameras()
        options = tuple(request.options.items())
        order = BatchSettings(self._blobs_url, epoch, request.chain, self._book.profiles(), documented, options)

        def report(_share: float = 0.0) -> None:
            if done.frames == frames_before:
                progress(done.frames, total, f"starting workers, no result of {counted(len(tasks), 'frame')} yet")
                return
            rate = (done.frames - frames_before) / max(1e-3, stopwatch_s() - started_s)
            progress(done.frames, total, f"{done.frames} of {total} frames, {rate:.{0 if rate >= 10 else 1}f} frames/s")

        report()
        with closing(self._executor.in_order(run_item, _batches(order, tasks), report)) as results:
            for rows in results:
                done.count(rows)
                elapsed_s = stopwatch_s() - started_s
                done.elapsed_s = round(before_s + elapsed_s, 3)
                self._keep(rows, done, keep)
                if (
                    done.frames == total
                    or elapsed_s - reported_s > REPORT_EVERY_S
                    or done.frames == frames_before + len(rows)
                ):
                    reported_s = elapsed_s
                    report()
        return {"frames": done.frames, "counts": done.counts or {}, "elapsed_s": done.elapsed_s}

    def _keep(self, rows: Sequence[TaskResult], done: ReprocessProgress, keep: Keep | None) -> None:
        common: dict[str, object] = {"origin": "ground", "created": self._now()}
        solutions = [{**common, **row} for row in rows if row["outcome"] != NOT_PROCESSED]
        with self._database.unit_of_work() as session:
            if solutions:
                store.add_solutions(session, solutions)
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
        frame.columns + dark_columns_of(frame).count,
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

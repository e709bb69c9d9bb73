"""Solves uploaded lists of measured stars as a job. The file and the results are stored as blobs. A database row
references the blobs.

The lists are read twice: at the upload, so that an invalid file is rejected immediately, and by the job, which uses
only its stored request. Workers receive batches of lists and return results, as in reprocessing.
"""

from __future__ import annotations

import io
import json
import math
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import TypedDict

from pydantic import Field

from gss import __version__
from gss.catalogue_tools.sources.hipparcos import EPOCH_RANGE_JYEAR
from gss.domain.camera import Camera
from gss.domain.errors import BadInput, NotFound
from gss.domain.results import Outcome
from gss.domain.words import counted
from gss.operations.clock import Now, processor_s
from gss.operations.folder_lock import named_lock
from gss.operations.frames.measured_list_files import StarLists, read_star_lists
from gss.operations.frames.measured_lists import (
    SIGMA_PX,
    ListRecord,
    ListResult,
    StarListSolver,
    list_result,
    without_distortion,
)
from gss.operations.frames.solver_cache import SolverCache
from gss.operations.jobs import JobKind, JobRequest, JobResult, JobRun, JobService
from gss.operations.parsing.parse_processes import ParseProcesses
from gss.operations.requests import Id, Request
from gss.operations.studies.camera_book import CameraBook
from gss.operations.studies.executor import Executor
from gss.store import list_runs as store
from gss.store import upkeep
from gss.store.blobs import BlobStore
from gss.store.engine import Database
from gss.store.models import Job, ListRun

KIND = "lists"
MAX_BYTES = 64 << 20
MAX_LISTS = 200_000
BATCH = 64


class ListRunRequest(Request):
    """Options for solving the lists of a file. ``no_distortion``: true if the positions are free of lens distortion;
    ``sigma_px``: error of a position per axis; ``epoch_jyear``: epoch of the star positions, None for the current
    epoch."""

    camera: str = Field(min_length=1, max_length=40)
    no_distortion: bool = False
    sigma_px: float = Field(default=SIGMA_PX, gt=0, le=20)
    epoch_jyear: float | None = Field(default=None, ge=EPOCH_RANGE_JYEAR[0], le=EPOCH_RANGE_JYEAR[1])


@dataclass(frozen=True)
class ListRunJob(JobRequest):
    """Job request for a stored run."""

    run_id: Id


@dataclass(frozen=True)
class ListBatch:
    """Batch of lists for a worker. ``faint_limit_mag``: magnitude limit of the camera."""

    lists: StarLists
    camera: Camera
    faint_limit_mag: float
    sigma_px: float
    epoch_jyear: float


class _Pointing(TypedDict):
    """Number of the list in the file, and its pointing in degrees."""

    list: int
    ra_deg: float | None
    dec_deg: float | None
    roll_deg: float | None


class ListRow(_Pointing, ListRecord):
    """Result of a list in the file of results."""


class ListRunService:
    """Stores uploaded lists, solves them as a job and returns their results. ``upkeep_lock``: lock file that a running
    backup locks. Meanwhile no blob may be deleted, because a backup needs every blob that its rows reference."""

    def __init__(
        self,
        database: Database,
        blobs: BlobStore,
        jobs: JobService,
        parsing: ParseProcesses,
        book: CameraBook,
        executor: Executor,
        now: Now,
        epoch_jyear: float,
        upkeep_lock: Path,
    ) -> None:
        self._database, self._blobs, self._jobs, self._parsing = database, blobs, jobs, parsing
        self._book, self._executor, self._now, self._epoch_jyear = book, executor, now, epoch_jyear
        self._upkeep_lock = upkeep_lock
        self._storing = threading.Lock()
        """Prevents the deletion of a blob between storing it and storing the row that references it."""
        jobs.register(JobKind(KIND, ListRunJob, self._solve))

    def start(self, data: bytes, filename: str, spec: ListRunRequest, *, user: str) -> tuple[ListRun, Job]:
        """Store the file and queue its job. Raises BadInput with file, row and reason, and NotFound for an unknown
        camera."""
        filename = "".join(c if c.isprintable() else "\N{REPLACEMENT CHARACTER}" for c in filename)[:120]
        if len(data) > MAX_BYTES:
            raise BadInput(
                f"{filename} is too large", expected=f"at most {MAX_BYTES >> 20} MiB", got=f"{len(data)} bytes"
            )
        self._jobs.check_room("star lists")
        self._book.profile(spec.camera)
        lists = self._read(data, filename)
        if len(lists) > MAX_LISTS:
            raise BadInput(
                f"{filename} has too many lists",
                expected=f"at most {MAX_LISTS}",
                got=str(len(lists)),
                hint="use gss solve-lists, or split the file",
            )
        row = ListRun(
            name=filename,
            created=self._now(),
            author=user,
            tool=f"gss {__version__}",
            camera=spec.camera,
            no_distortion=spec.no_distortion,
            sigma_px=spec.sigma_px,
            epoch_jyear=self._epoch_jyear if spec.epoch_jyear is None else spec.epoch_jyear,
            lists=len(lists),
            size=len(data),
        )
        with self._storing:
            row.sha256 = self._blobs.put(data)
            with self._database.unit_of_work() as session:
                row = store.add(session, row)
        title = f"{counted(len(lists), 'star list')} of {row.name}"
        return row, self._jobs.begin(KIND, title, ListRunJob(row.id, user=user))

    def newest(self, limit: int) -> list[ListRun]:
        """Return up to ``limit`` runs, latest first."""
        with self._database.unit_of_work() as session:
            return store.newest(session, limit)

    def get(self, run_id: int) -> ListRun:
        """Return the run with that id. Raises NotFound."""
        with self._database.unit_of_work() as session:
            return store.get(session, run_id)

    def remove(self, run_id: int) -> None:
        """Delete a run with its file and its results. A job of this run that is in progress fails at its end. Raises
        NotFound, and Conflict during a backup."""
        with self._storing, named_lock(self._upkeep_lock, "a backup or a removal is running"):
            with self._database.unit_of_work() as session:
                keys = store.remove(session, run_id)
            with self._database.unit_of_work() as session:
                unused = set(keys) - upkeep.still_needed(session, keys)
            for key in unused:
                self._blobs.delete(key)

    def results(self, run: ListRun, offset: int = 0, limit: int | None = None) -> Iterator[ListRow]:
        """Return one row of values for each list from ``offset`` on. Rows before ``offset`` are not decoded. Raises
        NotFound if the run has not been solved."""
        if not run.results_sha256:
            raise NotFound(
                "these star lists have no results",
                got=run.name,
                hint="wait for the job to end; after a cancelled or failed job, start it again",
            )
        lines = io.BytesIO(self._blobs.get(run.results_sha256))
        next(lines)
        end = run.lists if limit is None else min(run.lists, offset + limit)
        return (json.loads(line.rstrip(b",\n")) for line in islice(lines, offset, end))

    def _read(self, data: bytes, name: str) -> StarLists:
        return self._parsing.parse(read_star_lists, data, name, classes=(StarLists,), subject=name)

    def _solve(self, request: ListRunJob, run: JobRun) -> JobResult:
        row = self.get(request.run_id)
        profile = self._book.profile(row.camera)
        camera = without_distortion(profile.camera) if row.no_distortion else profile.camera
        lists = self._read(self._blobs.get(row.sha256), row.name)
        settings = (camera, profile.sensor.faint_limit_mag, row.sigma_px, row.epoch_jyear)
        rows: list[ListRow] = []
        solved = 0

        def report(_share: float = 0.0) -> None:
            run.progress(len(rows), len(lists), f"{len(rows)} of {len(lists)} lists, {solved} solved")

        report()
        batches = (ListBatch(part, *settings) for part in _batches(lists))
        with closing(self._executor.in_order(solve_batch, batches, report)) as batch_results:
            for results in batch_results:
                rows += [result_row(len(rows) + k, result) for k, result in enumerate(results)]
                solved += sum(result.outcome is Outcome.SOLVED for result in results)
                report()
        content = as_lines(rows)
        with self._storing:
            self.get(row.id)  # raises NotFound if the run was deleted in the meantime
            key = self._blobs.put(content)
            with self._database.unit_of_work() as session:
                store.finish(session, row.id, solved=solved, sha256=key, size=len(content))
        return {"list_run_id": row.id, "lists": len(rows), "solved": solved}


def as_lines(rows: Sequence[ListRow]) -> bytes:
    """Return a JSON array with a row per line, so that some rows can be read without decoding the others."""
    lines = (json.dumps(row, allow_nan=False, ensure_ascii=False) for row in rows)
    return ("[\n" + ",\n".join(lines) + "\n]").encode()


def _batches(lists: StarLists) -> Iterator[StarLists]:
    for start in range(0, len(lists), BATCH):
        offsets = lists.first[start : start + BATCH + 1]
        stars = slice(int(offsets[0]), int(offsets[-1]))
        yield StarLists(lists.col_px[stars], lists.row_px[stars], lists.flux[stars], offsets - offsets[0])


_cache = SolverCache()
"""Star positions and pair tables that a worker keeps between batches."""


def solve_batch(batch: ListBatch, _report_share: Callable[[float], None]) -> list[ListResult]:
    """Solve the lists of a batch for an executor."""
    solver = StarListSolver(batch.camera, batch.faint_limit_mag, batch.epoch_jyear, _cache, processor_s)
    return [list_result(*answer) for answer in solver.solve(batch.lists, batch.sigma_px)]


def result_row(index: int, result: ListResult) -> ListRow:
    """Return the result of a list in user units, with its number in the file."""
    pointing: _Pointing = {"list": index, "ra_deg": None, "dec_deg": None, "roll_deg": None}
    if result.quaternion is not None:
        ra, dec, roll = (math.degrees(a) for a in result.ra_dec_roll_rad)
        pointing = {"list": index, "ra_deg": ra, "dec_deg": dec, "roll_deg": roll}
    return {**pointing, **result.as_json()}

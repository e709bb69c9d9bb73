"""Rehearses pass plans as jobs. Each rehearsal runs in a separate process, with a folder that contains a copy of the
plan. The process has no access to the server's line, database or settings.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from pydantic import TypeAdapter

from gss.domain.errors import GssError
from gss.operations.clock import Now
from gss.operations.jobs import JobKind, JobRequest, JobResult, JobRun, JobService
from gss.operations.passes.plans import PlanService
from gss.operations.rehearsals.director import PERSON, SECOND
from gss.operations.rehearsals.rehearsal_report import REPORT, RehearsalOptions, RehearsalReport
from gss.operations.requests import Id
from gss.store import jobs as job_store
from gss.store import rehearsals as store
from gss.store.blobs import BlobStore
from gss.store.engine import Database, open_engine
from gss.store.migration import migrate
from gss.store.models import Job

KIND = "rehearsal"
ORDER_FILE = "rehearsal.json"
PER_MILLE = 1000
ABANDONED_AFTER_S = 86_400.0
"""A folder that has not changed for this time belongs to a rehearsal whose server was killed."""
Framing = Literal["", "cobs", "slip"]


@dataclass(frozen=True)
class RehearsalOrder:
    """Task of a rehearsal process, stored in its folder. ``packages``: folder of instrument packages; ``framing``:
    framing of the line, "" for the instrument's; ``auto_download``: true if the ground downloads each new frame, as the
    server does."""

    plan_id: int
    instrument: str
    packages: str
    framing: Framing
    auto_download: bool
    options: RehearsalOptions


ORDER = TypeAdapter(RehearsalOrder)


@dataclass(frozen=True)
class RehearsalJob(JobRequest):
    """The plan to rehearse."""

    plan_id: Id
    options: RehearsalOptions = field(default_factory=RehearsalOptions)


class RehearsalService:
    """Starts rehearsals and returns their reports. ``folder``: parent folder of the rehearsals' folders."""

    def __init__(
        self,
        database: Database,
        blobs: BlobStore,
        jobs: JobService,
        plans: PlanService,
        folder: Path,
        instrument: str,
        packages: Path,
        framing: Framing,
        auto_download: bool,
        now: Now,
    ) -> None:
        self._database, self._blobs, self._jobs, self._plans, self._folder = database, blobs, jobs, plans, folder
        self._instrument, self._packages, self._framing, self._now = instrument, packages, framing, now
        self._auto_download = auto_download
        jobs.register(JobKind(KIND, RehearsalJob, self._work))

    def start(self, plan_id: int, options: RehearsalOptions, *, user: str) -> Job:
        """Queue a rehearsal. Raises NotFound."""
        title = f"Rehearsal of {self._plans.get(plan_id).name}"
        return self._jobs.begin(KIND, title, RehearsalJob(plan_id, options, user=user))

    def newest(self, plan_id: int, limit: int) -> list[Job]:
        """Return the rehearsals of a plan, latest first."""
        with self._database.unit_of_work() as session:
            rows = job_store.newest(session, 200, KIND)
        return [row for row in rows if row.request.get("plan_id") == plan_id][:limit]

    def _work(self, request: RehearsalJob, run: JobRun) -> JobResult:
        report = self.run(
            request.plan_id, request.options, lambda share, text: run.progress(int(PER_MILLE * share), PER_MILLE, text)
        )
        return {"report": REPORT.dump_python(report, mode="json")}

    def run(self, plan_id: int, options: RehearsalOptions, progress: Callable[[float, str], None]) -> RehearsalReport:
        """Rehearse a plan and return the report. ``progress``: called with the completed share and the state of the
        plan; raises an exception to cancel. Raises NotFound, and GssError with the reason if the plan cannot be armed
        or the rehearsal fails."""
        self._folder.mkdir(parents=True, exist_ok=True)
        self._remove_abandoned()
        with tempfile.TemporaryDirectory(dir=self._folder, ignore_cleanup_errors=True) as name:
            self._prepare(Path(name), plan_id, options)
            return self._run(Path(name), progress)

    def _remove_abandoned(self) -> None:
        for folder in self._folder.iterdir():
            if self._now().timestamp() - folder.stat().st_mtime > ABANDONED_AFTER_S:
                shutil.rmtree(folder, ignore_errors=True)

    def _prepare(self, folder: Path, plan_id: int, options: RehearsalOptions) -> None:
        """Copy the plan and the data that it needs into a new store."""
        url = f"sqlite:///{folder / 'gss.db'}"
        migrate(url)
        target = Database(open_engine(url))
        try:
            with self._database.unit_of_work() as server_session, target.unit_of_work() as copy_session:
                keys = store.copy_plan(server_session, copy_session, plan_id)
                store.add_users(copy_session, [PERSON, SECOND], self._now())
        finally:
            target.close()
        blobs = BlobStore(str(folder / "blobs"))
        for key in keys:
            blobs.put(self._blobs.get(key))
        packages = str(self._packages.resolve())
        order = RehearsalOrder(plan_id, self._instrument, packages, self._framing, self._auto_download, options)
        (folder / ORDER_FILE).write_bytes(ORDER.dump_json(order))

    @staticmethod
    def _run(folder: Path, progress: Callable[[float, str], None]) -> RehearsalReport:
        """Run a rehearsal process, which writes one JSON object per line. The process does not inherit the settings of
        this server."""
        environment = {name: value for name, value in os.environ.items() if not name.startswith("GSS_")}
        command = [sys.executable, "-m", "gss", "rehearse", "--prepared", str(folder)]
        with (folder / "rehearsal.log").open("w+b") as log:
            process = subprocess.Popen(  # noqa: S603 - our own
                command, stdout=subprocess.PIPE, stderr=log, text=True, env=environment
            )
            try:
                for line in process.stdout or ():
                    message = json.loads(line)
                    if "report" in message:
                        return REPORT.validate_python(message["report"])
                    if "error" in message:
                        raise GssError(message["error"])
                    progress(message["share"], message["text"])
            finally:
                process.kill()
                process.wait()
                if process.stdout:
                    process.stdout.close()
            log.seek(0)
            last_line = log.read()[-500:].decode("utf-8", "replace").strip().splitlines()[-1:]
        raise GssError("the rehearsal process ended without a report", got=last_line[0] if last_line else "no message")

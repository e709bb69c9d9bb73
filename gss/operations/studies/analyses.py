"""Runs analyses of stored frames and of telemetry as jobs and stores their reports."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Any

import numpy as np

from gss import __version__
from gss.domain.angles import ARCSEC_RAD
from gss.domain.errors import BadInput
from gss.domain.profiles import profile
from gss.domain.words import counted
from gss.operations.clock import Now
from gss.operations.events import EventBus
from gss.operations.frames.solve import CHAINS, Solver
from gss.operations.jobs import JobService, Progress, Resumable, Run
from gss.operations.line.contacts import ContactService
from gss.operations.report.html import as_html
from gss.operations.report.parts import report_from
from gss.operations.report.pdf import as_pdf
from gss.operations.studies.analyse import FRAME_KINDS, analyse, analyse_telemetry, check_kind, run_frames
from gss.operations.studies.analyse import Analysis as Made
from gss.operations.studies.camera_book import CameraBook
from gss.operations.studies.night_frames import Shot, StoredShots
from gss.pipeline.analysis.series import AttitudeSeries
from gss.store import studies as store
from gss.store import telemetry
from gss.store.engine import Database
from gss.store.models import Analysis, Job

STEPS = 1000
MOST_FRAMES = 5000
MOST_ATTITUDES = 500_000
EXPORTS = {"json": "application/json", "html": "text/html; charset=utf-8", "pdf": "application/pdf"}
COLUMNS = (
    "frame_time_s",
    "outcome",
    "quaternion_x",
    "quaternion_y",
    "quaternion_z",
    "quaternion_w",
    "sigma_cross_arcsec",
    "sigma_roll_arcsec",
    "centroids",
    "matched",
)


@dataclass(frozen=True)
class FrameAnalysis:
    """Request for an analysis of frames. ``profile``: camera of the frames; ``other_*``: of a second camera, for two-cameras
    only."""

    kind: str
    profile: str
    frame_ids: tuple[int, ...]
    chain: str = "reference"
    commanded_rad_s: float | None = None
    other_profile: str = ""
    other_ids: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if self.kind not in FRAME_KINDS:
            raise BadInput("unknown analysis of frames", expected=" | ".join(FRAME_KINDS), got=self.kind)
        check_kind(self.kind, self.commanded_rad_s, len(self.other_ids))
        if self.chain not in CHAINS:
            raise BadInput("unknown chain", expected=" | ".join(CHAINS), got=self.chain)
        for ids in (self.frame_ids, self.other_ids):
            if len(ids) > MOST_FRAMES or len(set(ids)) != len(ids):
                raise BadInput("frames cannot be used", expected=f"up to {MOST_FRAMES}, each once", got=str(len(ids)))
        if not self.frame_ids:
            raise BadInput("no frames were given", expected="frames of one night")


@dataclass(frozen=True)
class TelemetryAnalysis:
    """Request for an analysis of a contact's attitudes."""

    contact_id: int


class AnalysisService:
    """Runs and stores analyses."""

    def __init__(
        self,
        database: Database,
        jobs: JobService,
        shots: StoredShots,
        solver: Solver,
        book: CameraBook,
        contacts: ContactService,
        bus: EventBus,
        now: Now,
    ) -> None:
        self._database, self._jobs, self._shots, self._solver = database, jobs, shots, solver
        self._book, self._contacts, self._bus, self._now = book, contacts, bus, now
        jobs.resumable("analysis", self._again)

    def start(self, wanted: FrameAnalysis | TelemetryAnalysis, title: str, *, user: str) -> Job:
        """Queue an analysis; its result contains the id of the stored row. Raises BadInput or NotFound before anything is
        queued."""
        name, work = self._work(wanted, title, user)
        asked = {"type": type(wanted).__name__, "wanted": vars(wanted), "title": title, "user": user}
        return self._jobs.begin("analysis", name, asked, work)

    def _again(self, run: Run) -> dict[str, Any]:
        made: Any = {c.__name__: c for c in (FrameAnalysis, TelemetryAnalysis)}[run.request["type"]]
        values = {k: tuple(v) if isinstance(v, list) else v for k, v in run.request["wanted"].items()}
        return self._work(made(**values), run.request["title"], run.request["user"])[1](run)

    def _work(self, wanted: FrameAnalysis | TelemetryAnalysis, title: str, user: str) -> tuple[str, Resumable]:
        """Return the name and work function of an analysis, after looking up its inputs."""
        request = {k: list(v) if isinstance(v, tuple) else v for k, v in vars(wanted).items()}
        first: list[Shot] = []
        other: list[Shot] = []
        if isinstance(wanted, TelemetryAnalysis):
            self._contacts.detail(wanted.contact_id)
            kind, of = "telemetry", f"contact {wanted.contact_id}"
        else:
            profile(wanted.profile)
            if wanted.other_ids:
                profile(wanted.other_profile)
            first, other = self._shots.of(wanted.frame_ids), self._shots.of(wanted.other_ids)
            kind, of = wanted.kind, counted(len(first), "frame")
        name = title or f"{kind}, {of}"

        def work(run: Run) -> dict[str, Any]:
            if run.checkpoint:  # the row was stored before the server stopped
                return run.checkpoint
            if isinstance(wanted, TelemetryAnalysis):
                made = self._of_contact(wanted)
            else:
                made = self._of_frames(wanted, first, other, run.progress)
            row = Analysis(
                kind=made.kind,
                title=name[:120],
                created=self._now(),
                author=user,
                tool=f"gss {__version__}",
                request=request,
                result={"report": made.report.as_dict(), "figures": made.figures},
            )
            with self._database.unit_of_work() as session:
                store.add_analysis(session, row)
                run.keep({"analysis_id": row.id}, session)
            self._bus.record("analysis", "ok", f"analysis {row.id} made: {row.title}, by {user}")
            return {"analysis_id": row.id}

        return name[:120], work

    def _of_frames(self, wanted: FrameAnalysis, first: list[Shot], other: list[Shot], progress: Progress) -> Made:
        share = 0.9 * len(first) / max(1, len(first) + len(other))

        def tell(done: float, text: str) -> None:
            progress(round(STEPS * done), STEPS, text)

        known = self._book.profile(wanted.profile)
        run = run_frames(self._solver, first, known, wanted.chain, lambda s, t: tell(share * s, t))
        second = None
        if other:
            camera = self._book.profile(wanted.other_profile)
            second = run_frames(
                self._solver, other, camera, wanted.chain, lambda s, t: tell(share + (0.9 - share) * s, t)
            )
        tell(0.92, "working out the figures")
        return analyse(wanted.kind, self._solver, run, second=second, commanded_rad_s=wanted.commanded_rad_s)

    def _of_contact(self, wanted: TelemetryAnalysis) -> Made:
        detail = self._contacts.detail(wanted.contact_id)
        end = max(detail.end, detail.row.started + timedelta(seconds=1))
        series = attitudes_of(self._database, wanted.contact_id, detail.row.started, end)
        return analyse_telemetry(
            series, f"attitudes of contact {wanted.contact_id}, {detail.row.started:%Y-%m-%d %H:%M}Z"
        )

    def newest(self, limit: int, kind: str = "") -> list[Analysis]:
        """Return the newest analyses first."""
        with self._database.unit_of_work() as session:
            return store.analyses(session, limit, kind)

    def get(self, analysis_id: int) -> Analysis:
        """Return the analysis with that id. Raises NotFound."""
        with self._database.unit_of_work() as session:
            return store.analysis(session, analysis_id)

    def export(self, analysis_id: int, kind: str) -> bytes:
        """Return the report as HTML or PDF, or all data as JSON."""
        row = self.get(analysis_id)
        if kind == "html":
            return as_html(report_from(row.result["report"])).encode()
        if kind == "pdf":
            return as_pdf(report_from(row.result["report"]), row.created)
        head = {"id": row.id, "kind": row.kind, "title": row.title, "author": row.author, "tool": row.tool}
        content = head | {"created": row.created.isoformat(), "request": row.request} | row.result
        return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False).encode()


def attitudes_of(database: Database, contact_id: int, start: datetime, end: datetime) -> AttitudeSeries:
    """Return the attitudes of a contact by device time, each frame once. Raises BadInput if there are none or too many."""
    found: dict[float, tuple[Any, ...]] = {}
    for row in telemetry.rows(database, "attitude", COLUMNS, start, end, contact_id=contact_id):
        if row.values[0] is not None:
            found[float(row.values[0])] = row.values
        if len(found) > MOST_ATTITUDES:
            raise BadInput("too many attitudes at once", expected=f"up to {MOST_ATTITUDES}", hint="a shorter contact")
    if not found:
        raise BadInput(
            "this contact has no attitudes", expected="attitude packets", hint="start the cycle, or ask for attitudes"
        )
    rows = [found[t] for t in sorted(found)]
    n = len(rows)
    quaternion, covariance = np.full((n, 4), np.nan), np.full((n, 3, 3), np.nan)
    for k, values in enumerate(rows):
        q = np.array([_number(v) for v in values[2:6]])
        if str(values[1]) == "solved" and abs(np.linalg.norm(q) - 1) < 1e-3:
            quaternion[k] = q / np.linalg.norm(q)
        cross, roll = (_number(v) * ARCSEC_RAD for v in values[6:8])
        covariance[k] = np.diag([cross**2, cross**2, roll**2]) if cross > 0 else np.nan
    counts = np.array([[int(v or 0) for v in values[8:10]] for values in rows], np.intp)
    return AttitudeSeries(
        np.array(sorted(found)), quaternion, covariance, counts[:, 0], counts[:, 1], np.full(n, np.nan)
    )


def _number(value: Any) -> float:
    """Return the number, NaN if the packet has none."""
    return math.nan if value is None else float(value)

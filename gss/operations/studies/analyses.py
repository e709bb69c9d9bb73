"""Runs analyses of stored frames and of telemetry as jobs and stores their reports."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np

from gss import __version__
from gss.domain.angles import ARCSEC_RAD, Array
from gss.domain.errors import BadInput, NotFound
from gss.domain.words import counted
from gss.instruments.telemetry_roles import Status
from gss.operations.clock import Now
from gss.operations.contacts.contacts import ContactService
from gss.operations.events import EventBus
from gss.operations.frames.solve import Solver
from gss.operations.jobs import JobKind, JobResult, JobRun, JobService, Progress, Work
from gss.operations.report.html import as_html
from gss.operations.report.parts import report_from
from gss.operations.report.pdf import as_pdf
from gss.operations.requests import as_stored
from gss.operations.studies.analyse import AnalysisResult, AnalysisRun, analyse, analyse_telemetry, run_frames
from gss.operations.studies.analysis_requests import (
    AnalysisJob,
    AnalysisRequest,
    FrameAnalysis,
    HealthRequest,
    MovingRequest,
    SheetRequest,
    TelemetryAnalysis,
    earlier_request,
)
from gss.operations.studies.camera_book import CameraBook
from gss.operations.studies.moving_objects import moving_objects, place_of_orbit
from gss.operations.studies.night_frames import Shot, StoredShots
from gss.operations.studies.sensor_health import (
    Surroundings,
    bad_pixel_table,
    orbit_within,
    places_below,
    sensor_health,
)
from gss.operations.studies.sheet_frames import NEAR_S, sheet_of_frames, sheet_of_simulation
from gss.orbit.trajectory import Trajectory
from gss.pipeline.analysis.series import AttitudeSeries
from gss.store import studies as store
from gss.store import telemetry
from gss.store.engine import Database
from gss.store.models import Analysis, Job

STEPS = 1000
MAX_ATTITUDES = 500_000
EXPORTS = {
    "json": "application/json",
    "html": "text/html; charset=utf-8",
    "pdf": "application/pdf",
    "tdm": "text/plain; charset=utf-8",
    "csv": "text/csv; charset=utf-8",
}
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
        orbit_at: Callable[[datetime], tuple[str, Trajectory] | None],
        bus: EventBus,
        now: Now,
    ) -> None:
        """``orbit_at``: function that returns name and orbit of the spacecraft at a time; None if no orbit covers the
        time."""
        self._database, self._jobs, self._shots, self._solver = database, jobs, shots, solver
        self._book, self._contacts, self._bus, self._now = book, contacts, bus, now
        self._orbit_at = orbit_at
        jobs.register(JobKind("analysis", AnalysisJob, self._analyse, older=earlier_request))

    def start(self, request: AnalysisRequest, *, user: str) -> Job:
        """Queue an analysis. The result of the job contains the id of the stored row. Raises BadInput or NotFound
        before the job is queued."""
        job = AnalysisJob(request, user=user)
        name, work = self._work(job)
        return self._jobs.begin("analysis", name, job, work)

    def _analyse(self, job: AnalysisJob, run: JobRun) -> JobResult:
        return self._work(job)[1](run)

    def _work(self, job: AnalysisJob) -> tuple[str, Work]:
        """Look up the inputs of an analysis, and return its title and the function that runs it."""
        analysis_request = job.wanted
        shots: list[Shot] = []
        other_shots: list[Shot] = []
        if isinstance(analysis_request, TelemetryAnalysis):
            self._contacts.detail(analysis_request.contact)
            kind, subject = "telemetry", f"contact {analysis_request.contact}"
        elif isinstance(analysis_request, MovingRequest | HealthRequest):
            self._book.profile(analysis_request.profile)
            shots = self._shots.of(analysis_request.frame_ids)
            kind = "health" if isinstance(analysis_request, HealthRequest) else "moving objects"
            subject = counted(len(shots), "frame")
        else:
            self._book.profile(analysis_request.profile)
            if analysis_request.other_ids:
                self._book.profile(analysis_request.other_profile)
            shots, other_shots = self._shots.of(analysis_request.frame_ids), self._shots.of(analysis_request.other_ids)
            kind, subject = analysis_request.kind, "simulated unit" if not shots else counted(len(shots), "frame")
        name = analysis_request.title or f"{kind}, {subject}"

        def work(run: JobRun) -> JobResult:
            if run.checkpoint:  # the row was stored before the server stopped
                return run.checkpoint
            if isinstance(analysis_request, TelemetryAnalysis):
                outcome = self._of_contact(analysis_request)
            elif isinstance(analysis_request, SheetRequest):
                outcome = self._sheet(analysis_request, shots, other_shots, run.progress)
            elif isinstance(analysis_request, MovingRequest):
                outcome = self._moving(analysis_request, shots, run.progress)
            elif isinstance(analysis_request, HealthRequest):
                outcome = self._health(analysis_request, shots, run.progress)
            else:
                outcome = self._of_frames(analysis_request, shots, other_shots, run.progress)
            row = Analysis(
                kind=outcome.kind,
                title=name[:120],
                created=self._now(),
                author=job.user,
                tool=f"gss {__version__}",
                request=as_stored(analysis_request),
                result={"report": outcome.report.as_dict(), "figures": outcome.figures},
            )
            with self._database.unit_of_work() as session:
                store.add_analysis(session, row)
                run.keep({"analysis_id": row.id}, session)
            self._bus.record("analysis", "ok", f"Analysis {row.id} completed for {job.user}: {row.title}")
            return {"analysis_id": row.id}

        return name[:120], work

    def _of_frames(
        self, request: FrameAnalysis, shots: list[Shot], other_shots: list[Shot], progress: Progress
    ) -> AnalysisResult:
        run, second = self._runs(request, shots, other_shots, progress)
        progress(round(0.92 * STEPS), STEPS, "Calculating the results")
        return analyse(request.kind, self._solver, run, second=second, commanded_rad_s=request.commanded_rad_s)

    def _sheet(
        self, request: SheetRequest, shots: list[Shot], other_shots: list[Shot], progress: Progress
    ) -> AnalysisResult:
        profile = self._book.profile(request.profile)

        def report(completed: float, text: str) -> None:
            progress(round(0.92 * STEPS * completed), STEPS, text)

        if request.simulated:
            return sheet_of_simulation(self._solver, profile, request.chain, request.seed, report)
        run, second = self._runs(request, shots, other_shots, progress)
        progress(round(0.92 * STEPS), STEPS, "Calculating the rows")
        mounting = None if request.mounting is None else tuple(request.mounting)
        warmth = None
        if second is not None:
            status = self._book.status_of(request.profile)
            warmth = temperatures(self._database, status, run.shots[0].taken, run.shots[-1].taken)
        return sheet_of_frames(run, second=second, mounting=mounting, temperature=warmth, seed=request.seed)

    def _moving(self, request: MovingRequest, shots: list[Shot], progress: Progress) -> AnalysisResult:
        def report(completed: float, text: str) -> None:
            progress(round(STEPS * completed), STEPS, text)

        camera_place = request.place
        if camera_place is None and (orbit := self._orbit_at(shots[0].taken)) is not None:
            camera_place = place_of_orbit(*orbit)
        profile = self._book.profile(request.profile)
        return moving_objects(
            self._solver,
            run_frames(self._solver, shots, profile, request.chain, lambda s, t: report(0.5 * s, t)),
            objects=request.objects,
            place=camera_place,
            top_rate_rad_s=request.top_rate_rad_s,
            created=self._now(),
            progress=report,
        )

    def _health(self, request: HealthRequest, shots: list[Shot], progress: Progress) -> AnalysisResult:
        def report(completed: float, text: str) -> None:
            progress(round(STEPS * completed), STEPS, text)

        def imported_orbit(at_s: float) -> Trajectory | None:
            named_orbit = self._orbit_at(datetime.fromtimestamp(at_s, UTC))
            return None if named_orbit is None else named_orbit[1]

        trajectories = request.trajectories
        orbit = orbit_within(trajectories) if trajectories else imported_orbit
        profile = self._book.profile(request.profile)
        run = run_frames(self._solver, shots, profile, request.chain, lambda s, t: report(0.5 * s, t))
        status = self._book.status_of(request.profile)
        unit_temperatures = temperatures(self._database, status, run.shots[0].taken, run.shots[-1].taken)
        surroundings = Surroundings(unit_temperatures, places_below(orbit))
        return sensor_health(self._solver, run, surroundings, lambda s, t: report(0.5 + 0.5 * s, t))

    def _runs(
        self, request: FrameAnalysis | SheetRequest, shots: list[Shot], other_shots: list[Shot], progress: Progress
    ) -> tuple[AnalysisRun, AnalysisRun | None]:
        """Run the chain on the frames of both cameras."""
        share = 0.9 * len(shots) / max(1, len(shots) + len(other_shots))

        def report(completed: float, text: str) -> None:
            progress(round(STEPS * completed), STEPS, text)

        profile = self._book.profile(request.profile)
        run = run_frames(self._solver, shots, profile, request.chain, lambda s, t: report(share * s, t))
        if not other_shots:
            return run, None
        camera = self._book.profile(request.other_profile)
        second = run_frames(
            self._solver, other_shots, camera, request.chain, lambda s, t: report(share + (0.9 - share) * s, t)
        )
        return run, second

    def _of_contact(self, request: TelemetryAnalysis) -> AnalysisResult:
        detail = self._contacts.detail(request.contact)
        end = max(detail.end, detail.row.started + timedelta(seconds=1))
        series = attitudes_of(self._database, request.contact, detail.row.started, end)
        return analyse_telemetry(
            series, f"attitudes of contact {request.contact}, {detail.row.started:%Y-%m-%d %H:%M}Z"
        )

    def newest(self, limit: int, kind: str = "") -> list[Analysis]:
        """Return up to ``limit`` analyses, latest first."""
        with self._database.unit_of_work() as session:
            return store.analyses(session, limit, kind)

    def get(self, analysis_id: int) -> Analysis:
        """Return the analysis with that id. Raises NotFound."""
        with self._database.unit_of_work() as session:
            return store.analysis(session, analysis_id)

    def export(self, analysis_id: int, kind: str) -> bytes:
        """Return an analysis as a file. ``kind``: html or pdf for the report, json for all data, tdm for the tracks of
        moving objects, csv for warm pixels."""
        row = self.get(analysis_id)
        if kind == "tdm":
            if row.kind != "moving":
                raise NotFound("this analysis has no tracking data", expected="kind moving", got=row.kind)
            return str(row.result["figures"]["tdm"]).encode()
        if kind == "csv":
            if row.kind != "health":
                raise NotFound("this analysis has no table of pixels", expected="kind health", got=row.kind)
            return bad_pixel_table(row.result["figures"])
        if kind == "html":
            return as_html(report_from(row.result["report"])).encode()
        if kind == "pdf":
            return as_pdf(report_from(row.result["report"]), row.created)
        head = {"id": row.id, "kind": row.kind, "title": row.title, "author": row.author, "tool": row.tool}
        content = head | {"created": row.created.isoformat(), "request": row.request} | row.result
        return json.dumps(content, indent=1, ensure_ascii=False, allow_nan=False).encode()


def attitudes_of(database: Database, contact_id: int, start: datetime, end: datetime) -> AttitudeSeries:
    """Return the attitudes of a contact in order of device time, one per frame. Raises BadInput if there are none or
    too many."""
    attitudes: dict[float, tuple[Any, ...]] = {}
    for row in telemetry.rows(database, "attitude", COLUMNS, start, end, contact_id=contact_id):
        if row.values[0] is not None:
            attitudes[float(row.values[0])] = row.values
        if len(attitudes) > MAX_ATTITUDES:
            raise BadInput("too many attitudes", expected=f"up to {MAX_ATTITUDES}", hint="select a shorter contact")
    if not attitudes:
        raise BadInput(
            "this contact has no attitudes", expected="attitude packets", hint="start the cycle, or request attitudes"
        )
    rows = [attitudes[t] for t in sorted(attitudes)]
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
        np.array(sorted(attitudes)), quaternion, covariance, counts[:, 0], counts[:, 1], np.full(n, np.nan)
    )


def temperatures(database: Database, status: Status, start: datetime, end: datetime) -> tuple[Array, Array] | None:
    """Return Unix seconds and °C of the unit's temperatures during a time span and shortly before and after it; None if
    the unit does not report its temperature."""
    if not (status.packet and status.sensor_temperature):
        return None
    margin = timedelta(seconds=NEAR_S)
    rows = telemetry.rows(database, status.packet, (status.sensor_temperature,), start - margin, end + margin)
    by_time = {r.received.timestamp(): float(r.values[0]) for r in rows if r.values[0] is not None}
    return np.array(sorted(by_time)), np.array([by_time[t] for t in sorted(by_time)])


def _number(value: Any) -> float:
    """Return a value as a number; NaN if the packet does not contain it."""
    return math.nan if value is None else float(value)

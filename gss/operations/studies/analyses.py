"""Runs analyses of stored frames and of telemetry as jobs and stores their reports."""

from __future__ import annotations

import json
from collections.abc import Callable
from datetime import UTC, datetime, timedelta

from gss import __version__
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import NotFound
from gss.domain.words import counted
from gss.operations.clock import Now
from gss.operations.contacts.contacts import ContactService
from gss.operations.events import EventBus
from gss.operations.frames.observer import epoch_at
from gss.operations.frames.solve import Solver
from gss.operations.jobs import JobKind, JobResult, JobRun, JobService, Progress, Work
from gss.operations.report.html import as_html
from gss.operations.report.parts import report_from
from gss.operations.report.pdf import as_pdf
from gss.operations.requests import as_stored
from gss.operations.studies.analyse import (
    TIMED_KINDS,
    AnalysisResult,
    AnalysisRun,
    analyse,
    analyse_telemetry,
    chain_for,
    run_frames,
)
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
from gss.operations.studies.reported import attitudes_of, star_lists_of, temperatures
from gss.operations.studies.sensor_health import (
    Surroundings,
    bad_pixel_table,
    orbit_within,
    places_below,
    sensor_health,
)
from gss.operations.studies.sheet_frames import sheet_of_frames, sheet_of_simulation, sheet_of_telemetry
from gss.orbit.trajectory import Trajectory
from gss.store import studies as store
from gss.store.engine import Database
from gss.store.models import Analysis, Job

STEPS = 1000
EXPORTS = {
    "json": "application/json",
    "html": "text/html; charset=utf-8",
    "pdf": "application/pdf",
    "tdm": "text/plain; charset=utf-8",
    "csv": "text/csv; charset=utf-8",
}


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
        elif isinstance(analysis_request, SheetRequest) and analysis_request.contact is not None:
            self._book.profile(analysis_request.profile)
            self._contacts.detail(analysis_request.contact)
            kind, subject = "sheet", f"contact {analysis_request.contact}"
        elif isinstance(analysis_request, MovingRequest | HealthRequest):
            self._book.profile(analysis_request.profile)
            shots = self._shots.of(analysis_request.frame_ids, timed=True)
            kind = "health" if isinstance(analysis_request, HealthRequest) else "moving objects"
            subject = counted(len(shots), "frame")
        else:
            self._book.profile(analysis_request.profile)
            if analysis_request.other_ids:
                self._book.profile(analysis_request.other_profile)
            shots, other_shots = self._shots_of(analysis_request)
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

    def sheet(self, request: SheetRequest, progress: Progress) -> AnalysisResult:
        """Return the performance sheet of a request without storing it. Raises BadInput or NotFound."""
        shots, other_shots = self._shots_of(request)
        return self._sheet(request, shots, other_shots, progress)

    def _shots_of(self, request: FrameAnalysis | SheetRequest) -> tuple[list[Shot], list[Shot]]:
        """Return the frames of both cameras."""
        timed = request.kind in TIMED_KINDS
        return self._shots.of(request.frame_ids, timed=timed), self._shots.of(request.other_ids, timed=timed)

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
            chain = chain_for(request.chain, profile)
            return sheet_of_simulation(self._solver, profile, chain, request.seed, report)
        if request.contact is not None:
            return self._sheet_of_contact(request.contact, profile, request.seed)
        run, second = self._runs(request, shots, other_shots, progress)
        progress(round(0.92 * STEPS), STEPS, "Calculating the rows")
        mounting = None if request.mounting is None else tuple(request.mounting)
        warmth = None
        if second is not None:
            status = self._book.quantities_of(request.profile).status
            warmth = temperatures(self._database, status, run.shots[0].taken, run.shots[-1].taken)
        return sheet_of_frames(
            self._solver, run, second=second, mounting=mounting, temperature=warmth, seed=request.seed
        )

    def _sheet_of_contact(self, contact_id: int, profile: CameraProfile, seed: int) -> AnalysisResult:
        """Return the sheet of the attitudes and star lists that the sensor reported during a contact."""
        detail, roles = self._contacts.detail(contact_id), self._book.quantities_of(profile.name)
        start = detail.row.started
        end = max(detail.end, start + timedelta(seconds=1))
        return sheet_of_telemetry(
            self._solver,
            profile,
            attitudes_of(self._database, roles.attitude, contact_id, start, end),
            star_lists_of(self._database, roles.centroids, profile, contact_id, start, end),
            f"attitudes and star lists of {profile.name}, contact {contact_id}, {start:%Y-%m-%d %H:%M}Z",
            epoch_jyear=epoch_at(start),
            seed=seed,
        )

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
        status = self._book.quantities_of(request.profile).status
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
        chain = chain_for(request.chain, profile)
        run = run_frames(self._solver, shots, profile, chain, lambda s, t: report(share * s, t))
        if not other_shots:
            return run, None
        camera = self._book.profile(request.other_profile)
        chain = chain_for(request.chain, camera)
        second = run_frames(self._solver, other_shots, camera, chain, lambda s, t: report(share + (0.9 - share) * s, t))
        return run, second

    def _of_contact(self, request: TelemetryAnalysis) -> AnalysisResult:
        detail = self._contacts.detail(request.contact)
        end = max(detail.end, detail.row.started + timedelta(seconds=1))
        role = self._contacts.quantities.attitude
        series = attitudes_of(self._database, role, request.contact, detail.row.started, end)
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

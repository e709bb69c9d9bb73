"""Creates instruments from stored photographs of the night sky, as jobs."""

from __future__ import annotations

from dataclasses import dataclass, replace

from gss.domain.errors import BadInput, Conflict
from gss.domain.json_object import JsonObject
from gss.domain.words import counted
from gss.instruments.package import Instrument
from gss.instruments.registry import Registry
from gss.operations.clock import Monotonic, Now
from gss.operations.events import EventBus
from gss.operations.frames.solve import Solver
from gss.operations.jobs import JobKind, JobRequest, JobResult, JobRun, JobService
from gss.operations.studies.new_instrument_requests import PhotographOptions, PhotographsRequest
from gss.operations.studies.night_frames import StoredShots
from gss.operations.studies.photograph_package import PhotographPackage, make_package
from gss.operations.studies.photographs import Photograph
from gss.pipeline.calibration.plain_values import as_record
from gss.store import frames as store
from gss.store.engine import Database
from gss.store.models import Job

KIND = "instrument"
STEPS = 1000


@dataclass(frozen=True)
class NewInstrumentJob(JobRequest):
    """Job request of an instrument from photographs."""

    wanted: PhotographsRequest


class NewInstrumentService:
    """Creates an instrument from stored frames and installs it."""

    def __init__(
        self,
        database: Database,
        jobs: JobService,
        shots: StoredShots,
        solver: Solver,
        instruments: Registry,
        bus: EventBus,
        now: Now,
        stopwatch_s: Monotonic,
    ) -> None:
        self._database, self._jobs, self._shots, self._solver = database, jobs, shots, solver
        self._instruments, self._bus, self._now, self._stopwatch_s = instruments, bus, now, stopwatch_s
        jobs.register(JobKind(KIND, NewInstrumentJob, self._create))

    def start(self, request: PhotographsRequest, *, user: str) -> Job:
        """Queue the job. Its result contains the name of the instrument and a row for each photograph. Raises Conflict
        if the name exists, NotFound for an unknown frame or model, and BadInput for an incomplete frame."""
        check_new_name(self._instruments, request.name)
        model_of(self._instruments, request)
        self._photographs(request)
        title = f"instrument {request.name} from {counted(len(request.frame_ids), 'photograph')}"
        return self._jobs.begin(KIND, title, NewInstrumentJob(request, user=user))

    def _create(self, job: NewInstrumentJob, run: JobRun) -> JobResult:
        if run.checkpoint:  # the package was installed before the server stopped
            return run.checkpoint
        options = job.wanted

        def progress(share: float, text: str) -> None:
            run.progress(round(STEPS * share), STEPS, text)

        check_new_name(self._instruments, options.name)
        package = make_package(
            self._solver,
            self._photographs(options),
            (),
            options,
            model_of(self._instruments, options),
            self._now(),
            self._stopwatch_s,
            progress,
        )
        instrument = self._instruments.add(package.files, replaces=False)
        result = record_of(package)
        run.keep(result)
        text = f"Instrument {instrument.name} version {instrument.version[:12]} created from photographs by {job.user}"
        self._bus.record("instrument", "watch", text, instrument=instrument.name, version=instrument.version)
        return result

    def _photographs(self, request: PhotographsRequest) -> list[Photograph]:
        shots = self._shots.of(request.frame_ids)
        with self._database.unit_of_work() as session:
            rows = {frame_id: store.get(session, frame_id) for frame_id in request.frame_ids}
        removed = [row.id for row in rows.values() if row.pixels_removed is not None]
        if removed:
            raise BadInput(
                "the pixels of a frame were removed", got=f"frame {removed[0]}", hint="import the file again"
            )
        photographs = []
        for shot in shots:
            row = rows[shot.frame_id or 0]
            name = f"{row.name} ({shot.name})" if row.name else shot.name
            photographs.append(Photograph(replace(shot, name=name), row.parameters.get("file", {})))
        return photographs


def check_new_name(instruments: Registry, name: str) -> None:
    """Raise Conflict if an instrument or a broken package has this name."""
    if name in instruments.names():
        raise Conflict("an instrument of this name exists", got=name, hint="choose another name")


def model_of(instruments: Registry, options: PhotographOptions) -> Instrument | None:
    """Return the instrument from which everything except the camera is copied; None if none is stated. Raises
    NotFound."""
    return instruments.get(options.model) if options.model else None


def record_of(package: PhotographPackage) -> JsonObject:
    """Return the result of the job as JSON values."""
    return {
        "name": package.instrument.name,
        "version": package.instrument.version,
        "summary": package.summary,
        "photographs": as_record(package.rows),
        "trials": as_record(package.trials),
        "warnings": list(package.warnings),
        "numbers": as_record([n for n in package.instrument.camera.numbers() if n.sigma is not None]),
    }

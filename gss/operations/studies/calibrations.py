"""Calibrations of a camera from its stored frames. They are computed as jobs, stored as versions, compared, used for
reruns, and sent to the sensor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gss import __version__
from gss.device.tables import BAD_PIXELS
from gss.domain.camera import Camera
from gss.domain.camera_profile import CameraProfile
from gss.domain.camera_record import camera_from
from gss.domain.errors import BadInput
from gss.domain.json_object import JsonObject
from gss.domain.words import counted
from gss.instruments.registry import Registry
from gss.operations.clock import Now
from gss.operations.events import EventBus
from gss.operations.frames.dark_frames import DARK, DarkFrames
from gss.operations.frames.solve import Solver
from gss.operations.jobs import JobKind, JobResult, JobRun, JobService, Work
from gss.operations.requests import as_stored
from gss.operations.studies import bench
from gss.operations.studies.bench_run import run_bench
from gss.operations.studies.calibrate import CalibrationInput, from_darks, from_stars
from gss.operations.studies.calibration_requests import (
    WITHOUT_CAMERA,
    BenchCalibration,
    CalibrationJob,
    CalibrationRequest,
    DetectorCalibration,
    StarCalibration,
    earlier_request,
)
from gss.operations.studies.camera_book import CameraBook
from gss.operations.studies.night_frames import ProgressCallback, Shot, StoredShots
from gss.operations.transfers.device_tables import DeviceTableService
from gss.operations.transfers.table_content import pixel_text
from gss.pipeline.calibration.apply import Difference, camera_difference
from gss.pipeline.calibration.bundle import Prior
from gss.pipeline.fixed_pattern import DarkPattern
from gss.store import studies as store
from gss.store.engine import Database
from gss.store.models import Calibration, DeviceTable, Job

STEPS = 1000
NO_BAD_PIXEL_TABLE = "The interface of this sensor has no bad-pixel table; ground reruns replace the bad pixels."
FOREIGN = "foreign"
"""Camera name of calibrations without a profile. Such a calibration can be used for a frame, but not sent to a
sensor."""


@dataclass(frozen=True)
class Comparison:
    """Comparison of two calibrations. ``geometry``: difference over the detector after the best common rotation;
    ``changed``: values that differ, (older, newer) by name."""

    older: Calibration
    newer: Calibration
    geometry: Difference
    changed: dict[str, tuple[float | str | None, float | str | None]]


class CalibrationService:
    """Computes, stores and provides calibrations."""

    def __init__(
        self,
        database: Database,
        jobs: JobService,
        shots: StoredShots,
        solver: Solver,
        book: CameraBook,
        tables: DeviceTableService,
        bus: EventBus,
        now: Now,
        darks: DarkFrames,
        instruments: Registry,
    ) -> None:
        self._instruments = instruments
        self._database, self._jobs, self._shots, self._solver = database, jobs, shots, solver
        self.book, self._tables, self._bus, self._now, self._darks = book, tables, bus, now, darks
        jobs.register(JobKind("calibration", CalibrationJob, self._calibrate, older=earlier_request))

    # --- computation --------------------------------------------------------------------------------------------

    def start(self, request: CalibrationRequest, *, user: str) -> Job:
        """Queue a calibration. The result of the job contains the id of the stored row. Raises BadInput before the job
        is queued."""
        job = CalibrationJob(request, user=user)
        title, work = self._work(job)
        return self._jobs.begin("calibration", title, job, work)

    def _calibrate(self, job: CalibrationJob, run: JobRun) -> JobResult:
        return self._work(job)[1](run)

    def _work(self, job: CalibrationJob) -> tuple[str, Work]:
        """Look up the inputs of a calibration, and return its title and the function that runs it."""
        calibration_request = job.wanted
        profile = self._camera(calibration_request)
        camera_name = profile.name if profile else FOREIGN
        shots = self._shots.of(calibration_request.frames)
        # The lens settings of a focus run are in the order of frame_ids, so the frames are returned to this order.
        if isinstance(calibration_request, BenchCalibration):
            position = {frame_id: k for k, frame_id in enumerate(calibration_request.frames)}
            shots.sort(key=lambda shot: position[shot.frame_id or 0])
        pairs = (
            [self._shots.of(pair) for pair in calibration_request.flat_pairs]
            if isinstance(calibration_request, DetectorCalibration)
            else []
        )
        priors = self._priors(calibration_request, camera_name)

        def work(run: JobRun) -> JobResult:
            if run.checkpoint:  # the row was stored before the server stopped
                return run.checkpoint

            def progress(share: float, text: str) -> None:
                run.progress(round(STEPS * share), STEPS, text)

            calibration = self._computed(calibration_request, profile, shots, pairs, priors, progress)
            row = Calibration(
                profile=camera_name,
                kind=calibration.kind,
                name=calibration_request.name or f"{camera_name} {calibration.kind}",
                created=self._now(),
                author=job.user,
                tool=f"gss {__version__}",
                request=as_stored(calibration_request),
                values=calibration.values,
                result=calibration.result,
                note=calibration_request.note,
            )
            with self._database.unit_of_work() as session:
                store.add_calibration(session, row)
                result = {"calibration_id": row.id, "warnings": len(calibration.result["warnings"])}
                run.keep(result, session)
            self._bus.record("calibration", "ok", f"Calibration {row.id} of {camera_name} completed for {job.user}")
            return result

        source = counted(len(shots), "frame") if shots else "the bench"
        return f"calibrate {camera_name} from {source}", work

    def _camera(self, request: CalibrationRequest) -> CameraProfile | None:
        """Return the documented camera. For a calibration from stars, the active detector calibration is applied to
        it."""
        if not request.profile:
            if isinstance(request, BenchCalibration) and not isinstance(request, WITHOUT_CAMERA):
                raise BadInput("this method needs a camera", expected="a profile", got="none")
            return None
        profile = self._instruments.camera(request.profile)
        if isinstance(request, StarCalibration) and self.book.dark_of(profile.name):
            active = self.book.profile(profile.name)
            return replace(active, camera=profile.camera, focal_mm=profile.focal_mm)
        return profile

    def _priors(self, request: CalibrationRequest, camera_name: str) -> dict[str, Prior]:
        if not isinstance(request, StarCalibration) or not request.prior_ids:
            return {}
        rows = [self.get(k) for k in request.prior_ids]
        other_cameras = [row for row in rows if row.profile not in (camera_name, FOREIGN)]
        if other_cameras:
            raise BadInput(
                "the prior was measured on another camera", expected=camera_name, got=other_cameras[0].profile
            )
        return bench.priors_of([(row.kind, row.result) for row in rows])

    def _computed(
        self,
        request: CalibrationRequest,
        profile: CameraProfile | None,
        shots: Sequence[Shot],
        pairs: Sequence[Sequence[Shot]],
        priors: Mapping[str, Prior],
        progress: ProgressCallback,
    ) -> CalibrationInput:
        if isinstance(request, BenchCalibration):
            return run_bench(self._solver, request, profile, shots, progress)
        if isinstance(request, DetectorCalibration):
            assert profile is not None  # noqa: S101 - its profile is never empty
            return from_darks(shots, pairs, profile, progress, self._darks.keep)
        calibration = from_stars(
            self._solver,
            shots,
            profile,
            progress,
            models=request.models,
            fov_rad=request.fov_rad,
            photometry=request.photometry,
            psf=request.psf,
            priors=priors,
        )
        dark = profile.sources.get(DARK, "") if profile else ""
        return replace(calibration, result=calibration.result | {"dark_frame": dark}) if dark else calibration

    def from_health(self, analysis_id: int, *, user: str) -> Calibration:
        """Store the calibration that a health analysis proposes. It contains values of the sensor, and the bad pixels
        of the active dark frame together with the new bad pixels. Raises NotFound, and BadInput for another kind of
        analysis."""
        with self._database.unit_of_work() as session:
            analysis = store.analysis(session, analysis_id)
        if analysis.kind != "health":
            raise BadInput("this analysis proposes no calibration", expected="kind health", got=analysis.kind)
        camera_name, proposal = str(analysis.request["profile"]), analysis.result["figures"]["proposal"]
        result: JsonObject = {"health": {"changes": proposal["changes"]}, "warnings": []}
        bad_pixels = np.array(proposal["bad"], np.intp).reshape(-1, 2)
        if len(bad_pixels) or self.book.dark_of(camera_name):
            result["dark_frame"] = self._darks.keep_pattern(self._with_bad(camera_name, bad_pixels))
        row = Calibration(
            profile=camera_name,
            kind="health",
            name=f"health, analysis {analysis_id}",
            created=self._now(),
            author=user,
            tool=f"gss {__version__}",
            request={"kind": "health", "analysis_id": analysis_id, "frame_ids": analysis.request["frame_ids"]},
            values=proposal["values"],
            result=result,
            note="",
        )
        with self._database.unit_of_work() as session:
            store.add_calibration(session, row)
        self._bus.record(
            "calibration", "ok", f"Calibration {row.id} of {camera_name} proposed by analysis {analysis_id}, by {user}"
        )
        return row

    def _with_bad(self, camera_name: str, bad_pixels: NDArray[np.intp]) -> DarkPattern:
        """Return the active dark frame with additional bad pixels. If there is no active dark frame, return a map that
        only replaces the bad pixels."""
        key, profile = self.book.dark_of(camera_name), self.book.profile(camera_name)
        if not key:
            flat = np.zeros((profile.camera.rows, profile.camera.columns), np.float32)
            return DarkPattern(flat, bad_pixels, profile.sensor.exposure_s)
        stored_pattern = self._darks.pattern(key)
        return replace(stored_pattern, bad=np.unique(np.concatenate([stored_pattern.bad, bad_pixels]), axis=0))

    # --- queries ------------------------------------------------------------------------------------------------

    def newest(self, limit: int, profile_name: str = "") -> list[Calibration]:
        """Return up to ``limit`` calibrations, latest first."""
        with self._database.unit_of_work() as session:
            return store.calibrations(session, limit, profile_name)

    def get(self, calibration_id: int) -> Calibration:
        """Return the calibration with that id. Raises NotFound."""
        with self._database.unit_of_work() as session:
            return store.calibration(session, calibration_id)

    def camera(self, calibration_id: int) -> Camera:
        """Return the camera geometry of a calibration."""
        return self._camera_of(self.get(calibration_id))

    def compare(self, older_id: int, newer_id: int) -> Comparison:
        """Return the differences between two calibrations of the same camera. Raises BadInput for different cameras."""
        older, newer = self.get(older_id), self.get(newer_id)
        if older.profile != newer.profile:
            raise BadInput("the calibrations are of different cameras", expected=older.profile, got=newer.profile)
        names = sorted(set(older.values) | set(newer.values))
        pairs = {n: (older.values.get(n), newer.values.get(n)) for n in names}
        changed = {n: pair for n, pair in pairs.items() if pair[0] != pair[1]}
        return Comparison(older, newer, camera_difference(self._camera_of(older), self._camera_of(newer)), changed)

    # --- use ----------------------------------------------------------------------------------------------------

    def use(self, calibration_id: int, *, user: str) -> Calibration:
        """Use a calibration for reruns from now on. Raises BadInput if it does not define the camera of a profile."""
        row = self.get(calibration_id)
        if not row.values:
            raise _no_values(row)
        self.book.use(calibration_id, user=user)
        self._bus.record("calibration", "ok", f"{row.profile}: {user} selected calibration {row.id} for reruns")
        return row

    def use_documented(self, profile_name: str, *, user: str) -> None:
        """Use the documented camera for reruns again."""
        self.book.use_documented(profile_name)
        self._bus.record("calibration", "ok", f"{profile_name}: {user} selected the documented camera for reruns")

    def table(self, calibration_id: int, *, user: str) -> DeviceTable:
        """Return the calibration as a table for the sensor, which can be uploaded, verified and activated. The table is
        created on the first call."""
        row = self.get(calibration_id)
        if row.table_id is not None:
            return self._tables.get(row.table_id)
        if not row.values:
            raise _no_values(row)
        table = self._tables.create("calibration", row.name, row.profile, row.values, user=user)
        with self._database.unit_of_work() as session:
            store.calibration(session, calibration_id).table_id = table.id
        return table

    def bad_pixel_table(self, calibration_id: int, *, user: str) -> DeviceTable:
        """Return the bad pixels of a calibration as a table for the sensor. The table is created on the first call.
        Raises BadInput if the calibration has no bad pixels or the sensor has no such table."""
        row = self.get(calibration_id)
        if row.bad_pixel_table_id is not None:
            return self._tables.get(row.bad_pixel_table_id)
        if not self.takes_bad_pixels(row):
            raise BadInput(NO_BAD_PIXEL_TABLE, expected="a sensor with this table", got=row.profile)
        bad_pixels = self._darks.bad_pixels(row.result.get("dark_frame"))
        if not len(bad_pixels):
            raise BadInput(
                "this calibration has no bad pixels", expected="a health analysis or dark frames", got=row.kind
            )
        content = {"pixels": pixel_text(bad_pixels)}
        table = self._tables.create(BAD_PIXELS, row.name, row.profile, content, user=user)
        with self._database.unit_of_work() as session:
            store.calibration(session, calibration_id).bad_pixel_table_id = table.id
        return table

    def takes_bad_pixels(self, row: Calibration) -> bool:
        """True if the interface of the calibration's sensor has a bad-pixel table."""
        return self._instruments.has(row.profile) and self._tables.takes(BAD_PIXELS, row.profile)

    def _camera_of(self, row: Calibration) -> Camera:
        """Return the camera geometry of a calibration. Raises BadInput if it has none."""
        if row.values:
            return self.book.with_values(row.profile, row.values, row.id).camera
        record = row.result.get("geometry", row.result).get("camera")
        if record is None:
            raise BadInput(
                "this calibration covers only part of a camera", expected="stars or a checkerboard", got=row.kind
            )
        return camera_from(record)


def _no_values(row: Calibration) -> BadInput:
    """Return the error for a calibration that does not define a profile's camera."""
    if row.kind in bench.KINDS and row.profile != FOREIGN:
        prior = row.kind in bench.PRIOR_KINDS
        return BadInput(
            "a bench calibration covers only part of a camera",
            expected="a calibration from stars or darks",
            got=row.kind,
            hint="calibrate from stars and select it as a prior" if prior else "see its report",
        )
    return BadInput(
        "this camera has no profile",
        expected="a calibration of a sensor's camera",
        got=row.profile,
        hint="select the calibration when you run a frame",
    )

"""Calibrations of a camera from its own stored frames: made as jobs, kept as versions, compared, used, sent to the sensor."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from gss import __version__
from gss.domain.camera import Camera
from gss.domain.errors import BadInput
from gss.domain.profiles import profile
from gss.operations.calibrate import check_models, from_darks, from_stars
from gss.operations.camera_book import CameraBook, with_values
from gss.operations.clock import Now
from gss.operations.device_tables import DeviceTableService
from gss.operations.events import EventBus
from gss.operations.jobs import JobService, Progress
from gss.operations.night_frames import StoredShots
from gss.operations.solve import Solver
from gss.pipeline.calibration.apply import Difference, camera_difference
from gss.pipeline.calibration.record import camera_from_record
from gss.store import studies as store
from gss.store.engine import Database
from gss.store.models import Calibration, DeviceTable, Job

STEPS = 1000
MOST_FRAMES = 2000
FOREIGN = "foreign"
"""The camera's name where no profile is known: it can be calibrated and used, but not sent to a sensor."""


@dataclass(frozen=True)
class StarCalibration:
    """Calibrate from frames of stars. ``profile`` "": a camera that nobody described, solved blind. ``models``: lens models
    to choose from, all where empty."""

    frame_ids: tuple[int, ...]
    profile: str = ""
    models: tuple[str, ...] = ()
    photometry: bool = True
    psf: bool = True
    fov_rad: float | None = None

    def __post_init__(self) -> None:
        check_models(self.models)
        _check_frames("frames", self.frame_ids, 1)


@dataclass(frozen=True)
class DetectorCalibration:
    """Calibrate the detector from dark frames of one exposure and, where there are any, pairs of flat fields."""

    profile: str
    dark_ids: tuple[int, ...]
    flat_pairs: tuple[tuple[int, int], ...] = ()

    def __post_init__(self) -> None:
        _check_frames("dark frames", self.dark_ids, 3)


def _check_frames(what: str, ids: Sequence[int], fewest: int) -> None:
    if not fewest <= len(ids) <= MOST_FRAMES or len(set(ids)) != len(ids):
        raise BadInput(
            f"{what} cannot be used",
            expected=f"{fewest} to {MOST_FRAMES}, each once",
            got=f"{len(ids)}, {len(set(ids))} different",
        )


@dataclass(frozen=True)
class Comparison:
    """Two versions side by side: how far apart their geometries are over the detector, after the best common rotation."""

    older: Calibration
    newer: Calibration
    geometry: Difference
    changed: dict[str, tuple[float | str | None, float | str | None]]


class CalibrationService:
    """Makes, keeps and hands out calibrations."""

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
    ) -> None:
        self._database, self._jobs, self._shots, self._solver = database, jobs, shots, solver
        self.book, self._tables, self._bus, self._now = book, tables, bus, now

    # --- making -------------------------------------------------------------------------------------------------

    def start(self, wanted: StarCalibration | DetectorCalibration, name: str, note: str, *, user: str) -> Job:
        """Queue a calibration; its result names the row. BadInput before anything is queued."""
        known = profile(wanted.profile) if wanted.profile else None
        of = known.name if known else FOREIGN
        first = wanted.frame_ids if isinstance(wanted, StarCalibration) else wanted.dark_ids
        shots = self._shots.of(first)
        pairs = [] if isinstance(wanted, StarCalibration) else [self._shots.of(pair) for pair in wanted.flat_pairs]
        request = _request(wanted)

        def work(progress: Progress) -> dict[str, Any]:
            def tell(share: float, text: str) -> None:
                progress(round(STEPS * share), STEPS, text)

            if isinstance(wanted, StarCalibration):
                found = from_stars(
                    self._solver,
                    shots,
                    known,
                    tell,
                    models=wanted.models,
                    fov_rad=wanted.fov_rad,
                    photometry=wanted.photometry,
                    psf=wanted.psf,
                )
            else:
                found = from_darks(shots, pairs, profile(wanted.profile), tell)
            row = Calibration(
                profile=of,
                kind=found.kind,
                name=name or f"{of} {found.kind}",
                created=self._now(),
                author=user,
                tool=f"gss {__version__}",
                request=request,
                values=found.values,
                result=found.result,
                note=note,
            )
            with self._database.unit_of_work() as session:
                store.add_calibration(session, row)
            self._bus.record("calibration", "ok", f"calibration {row.id} of {of} made, by {user}")
            return {"calibration_id": row.id, "warnings": len(found.result["warnings"])}

        return self._jobs.submit("calibration", f"calibrate {of} from {len(shots)} frames", request, work)

    # --- reading ------------------------------------------------------------------------------------------------

    def newest(self, limit: int, profile_name: str = "") -> list[Calibration]:
        """Newest first."""
        with self._database.unit_of_work() as session:
            return store.calibrations(session, limit, profile_name)

    def get(self, calibration_id: int) -> Calibration:
        """The calibration of that id."""
        with self._database.unit_of_work() as session:
            return store.calibration(session, calibration_id)

    def camera(self, calibration_id: int) -> Camera:
        """The geometry that a version stands for."""
        return camera_of(self.get(calibration_id))

    def compare(self, older_id: int, newer_id: int) -> Comparison:
        """What changed from one version to another of the same camera."""
        older, newer = self.get(older_id), self.get(newer_id)
        if older.profile != newer.profile:
            raise BadInput("these calibrations are of different cameras", expected=older.profile, got=newer.profile)
        names = sorted(set(older.values) | set(newer.values))
        pairs = {n: (older.values.get(n), newer.values.get(n)) for n in names}
        changed = {n: pair for n, pair in pairs.items() if pair[0] != pair[1]}
        return Comparison(older, newer, camera_difference(camera_of(older), camera_of(newer)), changed)

    # --- using --------------------------------------------------------------------------------------------------

    def use(self, calibration_id: int, *, user: str) -> Calibration:
        """Rerun frames with this camera from now on."""
        row = self.get(calibration_id)
        if not row.values:
            raise BadInput("this camera has no profile", hint="name the calibration when you run a frame")
        self.book.use(calibration_id, user=user)
        self._bus.record("calibration", "ok", f"{row.profile}: calibration {row.id} is used for reruns, by {user}")
        return row

    def use_documented(self, profile_name: str, *, user: str) -> None:
        """Rerun frames with the documented camera again."""
        self.book.use_documented(profile_name)
        self._bus.record("calibration", "ok", f"{profile_name}: the documented camera is used for reruns, by {user}")

    def table(self, calibration_id: int, *, user: str) -> DeviceTable:
        """The calibration as a table for the sensor, made once; from there it is sent, verified and activated."""
        row = self.get(calibration_id)
        if row.table_id is not None:
            return self._tables.get(row.table_id)
        if not row.values:
            raise BadInput("this camera has no profile", expected="a calibration of a sensor's camera", got=row.profile)
        table = self._tables.create("calibration", row.name, row.profile, row.values, user=user)
        with self._database.unit_of_work() as session:
            store.calibration(session, calibration_id).table_id = table.id
        return table


def camera_of(row: Calibration) -> Camera:
    """The geometry that a version stands for."""
    if row.values:
        return with_values(row.profile, row.values, row.id).camera
    return camera_from_record(row.result["geometry"]["camera"])


def _request(wanted: StarCalibration | DetectorCalibration) -> dict[str, Any]:
    plain: Mapping[str, Any] = vars(wanted)
    return {k: list(v) if isinstance(v, tuple) else v for k, v in plain.items()}

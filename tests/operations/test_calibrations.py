"""Calibrations: created from stored frames, versioned, compared, used for reruns and exported as a sensor table."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from astropy.table import Table

from gss.catalogue_tools.sources.hipparcos import propagate
from gss.device.table_use import calibration_values
from gss.domain.camera import Brown, Camera
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput, NotFound
from gss.domain.frames import cam_from_icrs
from gss.instruments.registry import Registry, shipped_camera
from gss.operations.clock import Now
from gss.operations.events import EventBus
from gss.operations.frames.solve import SolveRequest
from gss.operations.report.parts import report_from
from gss.operations.studies.calibration_export import export_calibration
from gss.operations.studies.calibration_requests import BenchCentre, DetectorCalibration, StarCalibration
from gss.operations.studies.calibration_sheet import calibration_sheet
from gss.operations.studies.camera_book import CameraBook
from gss.pipeline.render import render
from gss.settings import Settings
from gss.store import studies
from gss.store.engine import Database
from gss.store.models import Calibration, Job
from gss.wiring.build import build
from gss.wiring.services import Services

NIGHT = datetime(2026, 12, 1, 20, tzinfo=UTC)
FRAMES = 8
DOCUMENTED = shipped_camera("cubestar")
TRUE = replace(
    DOCUMENTED.camera,
    focal_col_px=DOCUMENTED.camera.focal_col_px * 1.002,
    focal_row_px=DOCUMENTED.camera.focal_row_px * 1.002,
    centre_col_px=DOCUMENTED.camera.centre_col_px + 3.0,
    centre_row_px=DOCUMENTED.camera.centre_row_px - 2.0,
    distortion=Brown(-0.31, 0.11, 0.002, -0.003),
)
"""The camera of this unit; it differs from the documented one."""


@dataclass
class Night:
    """Services with stored frames of one night."""

    services: Services
    frames: tuple[int, ...]
    darks: tuple[int, ...]
    flats: tuple[tuple[int, int], ...]
    attitudes: list[np.ndarray]

    def done(self, job: Job) -> Job:
        """Return the job after its end."""
        end = time.monotonic() + 600
        while time.monotonic() < end:
            current = self.services.base.jobs.get(job.id)
            if current.state not in ("queued", "running"):
                return current
            time.sleep(0.05)
        raise AssertionError("the job did not end")


@pytest.fixture(scope="module")
def night(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Night]:
    """Services with eight frames of stars by the real camera, five darks and three pairs of flats."""
    services = build(Settings(data=Path(tmp_path_factory.mktemp("night"))))
    services.base.jobs.start()
    rng = np.random.default_rng(5)
    stars = propagate(services.base.stars, 2027.0)
    sensor = replace(DOCUMENTED.sensor, zero_point_e_s=DOCUMENTED.sensor.zero_point_e_s * 0.8)
    attitudes, ids = [], []

    def keep(pixels: np.ndarray, k: int) -> int:
        frame, _ = services.frames.frames._add(
            pixels,
            source="import",
            taken=NIGHT + timedelta(seconds=60 * k),
            bits=8,
            exposure_s=0.25,
            profile="cubestar",
        )
        return frame.id

    for k in range(FRAMES):
        attitude = cam_from_icrs(float(rng.uniform(0, 6.28)), float(rng.uniform(-1, 1)), float(rng.uniform(0, 6.28)))
        attitudes.append(attitude)
        ids.append(keep(render(stars, TRUE, sensor, attitude, 0.25, rng).pixels, k))
    level = lambda mean: rng.poisson(mean * 5.0, (512, 1024)) / 5.0 + rng.normal(8.0, 1.2, (512, 1024))  # noqa: E731
    as_frame = lambda image: np.clip(np.round(image), 0, 255).astype(np.uint8)  # noqa: E731
    hot = np.zeros((512, 1024))
    hot[100, 200] = 90.0
    darks = tuple(keep(as_frame(level(2.0) + hot), 20 + k) for k in range(5))
    flats = tuple((keep(as_frame(level(m)), 30), keep(as_frame(level(m)), 31)) for m in (20.0, 60.0, 120.0))
    yield Night(services, tuple(ids), darks, flats, attitudes)
    services.base.jobs.stop()
    services.frames.frames.stop()
    services.base.database.close()


def from_stars(ids: tuple[int, ...], *, profile: str = "cubestar", **more: Any) -> StarCalibration:
    """Return a request for a calibration from these frames."""
    return StarCalibration(kind="stars", profile=profile, frame_ids=list(ids), **more)


def from_darks(ids: tuple[int, ...], flats: tuple[tuple[int, int], ...] = ()) -> DetectorCalibration:
    """Return a request for a calibration from these dark frames and flat fields."""
    pairs = [list(pair) for pair in flats]
    return DetectorCalibration(kind="detector", profile="cubestar", dark_ids=list(ids), flat_pairs=pairs)


@pytest.fixture(scope="module")
def calibrated(night: Night) -> int:
    """Id of a calibration from all star frames."""
    request = from_stars(night.frames, name="roof", note="first light")
    job = night.done(night.services.studies.calibrations.start(request, user="engineer-1"))
    assert job.state == "done", job.text
    return int(job.result["calibration_id"])


def test_a_camera_is_calibrated_from_its_own_frames(night: Night, calibrated: int) -> None:
    """Focal length, centre and photometry of the unit are measured from frames that were solved with the documented
    camera.
    """
    row = night.services.studies.calibrations.get(calibrated)
    assert row.kind == "stars"
    assert row.author == "engineer-1"
    assert abs(row.values["focal_col_px"] / TRUE.focal_col_px - 1) < 4e-4
    geometry = row.result["geometry"]
    assert geometry["residuals"]["rms_px"] < 0.5 * geometry["before"]["rms_px"]
    assert abs(2.5 * np.log10(row.values["zero_point_e_s"] / (0.8 * DOCUMENTED.sensor.zero_point_e_s))) < 0.1


def test_the_selected_calibration_is_used_for_reruns_and_reported(night: Night, calibrated: int) -> None:
    """After selection, results use the calibration, are more accurate and name it; the documented camera can be
    selected again.
    """
    services = night.services
    before = services.frames.frames.solve(night.frames[0], SolveRequest(profile="cubestar"))
    services.studies.calibrations.use(calibrated, user="engineer-1")
    after = services.frames.frames.solve(night.frames[0], SolveRequest(profile="cubestar"))
    assert after.rms_px < 0.6 * before.rms_px
    assert f"camera: calibration {calibrated}" in after.notes
    base = services.base
    assert CameraBook(base.database, base.instruments, base.bus, lambda: NIGHT).in_use("cubestar") == calibrated
    services.studies.calibrations.use_documented("cubestar", user="engineer-1")
    again = services.frames.frames.solve(night.frames[0], SolveRequest(profile="cubestar"))
    assert again.rms_px == pytest.approx(before.rms_px)
    with pytest.raises(NotFound):
        services.studies.calibrations.use_documented("cubestar", user="engineer-1")


def installed(instruments: Registry, *changes: tuple[bytes, bytes]) -> CameraProfile:
    """Install a copy of CubeStar's package as "mycam", with these changes of its camera. Return its camera."""
    files = dict(instruments.get("cubestar").files)
    files["instrument.yaml"] = files["instrument.yaml"].replace(b"id: cubestar", b"id: mycam")
    for old, new in changes:
        assert old in files["camera.yaml"]
        files["camera.yaml"] = files["camera.yaml"].replace(old, new)
    return instruments.add(files).profile


def test_a_replaced_package_applies_to_its_active_calibration(
    tmp_path: Path, database: Database, bus: EventBus, clock: Now
) -> None:
    """A replaced package applies at once to the camera with the calibrated values. If the calibration does not fit the
    package, the documented camera is used, an event states the reason once, and the next server starts. It is used
    again with a package that it fits.
    """
    (tmp_path / "instruments").mkdir()
    instruments = Registry(tmp_path / "instruments")
    values = calibration_values(installed(instruments)) | {"focal_col_px": DOCUMENTED.camera.focal_col_px * 1.01}
    row = Calibration(profile="mycam", kind="stars", name="n", created=NIGHT, author="ann", tool="t", note="")
    row.values, row.request, row.result = values, {}, {"dark_frame": {"key": "dark"}}
    with database.unit_of_work() as session:
        calibration_id = studies.add_calibration(session, row).id
    book = CameraBook(database, instruments, bus, clock)
    book.use(calibration_id, user="ann")
    before = book.profile("mycam")
    assert book.profile("mycam") is before
    corrected = installed(instruments, (b"sun: {value: 45", b"sun: {value: 50"))
    used = book.profile("mycam")
    assert (used.baffle, used.camera) == (corrected.baffle, before.camera)
    assert (used.baffle != before.baffle, book.dark_of("mycam")) == (True, "dark")
    other = installed(instruments, (b"bits: {value: 8", b"bits: {value: 12"))
    for server in (book, CameraBook(database, instruments, bus, clock)):
        assert server.profile("mycam") == server.profiles()["mycam"] == other
        assert (server.in_use("mycam"), server.dark_of("mycam")) == (None, "")
    texts = [event.text for event in bus.after(0, 10)]
    assert ["another detector" in text for text in texts] == [True, True]
    with pytest.raises(BadInput, match="another detector"):
        book.use(calibration_id, user="ann")
    installed(instruments)
    assert (book.profile("mycam"), book.in_use("mycam")) == (before, calibration_id)


def test_versions_are_compared_over_the_detector(night: Night, calibrated: int) -> None:
    """A second version from fewer frames differs by less than a pixel, and the changed values are listed."""
    services = night.services
    wanted = from_stars(night.frames[:6], photometry=False, psf=False)
    job = night.done(services.studies.calibrations.start(wanted, user="engineer-1"))
    comparison = services.studies.calibrations.compare(calibrated, int(job.result["calibration_id"]))
    assert 0 < comparison.geometry.rms_px < 1.0
    assert "focal_col_px" in comparison.changed
    assert "columns" not in comparison.changed


def test_a_calibration_becomes_a_table_once(night: Night, calibrated: int) -> None:
    """The sensor's table contains the calibration's values; a second request returns the same table."""
    services = night.services
    table = services.studies.calibrations.table(calibrated, user="engineer-1")
    assert table.kind == "calibration"
    assert table.content["focal_col_px"] == pytest.approx(
        services.studies.calibrations.get(calibrated).values["focal_col_px"]
    )
    assert services.studies.calibrations.table(calibrated, user="engineer-1").id == table.id


def test_dark_frames_and_flats_calibrate_the_detector(night: Night) -> None:
    """Darks and flats give a gain of five electrons per digital number, and the hot pixel at its position. The report
    states that the read noise, which needs a dark pair, is not determined. Signals are above the dark frames."""
    services = night.services
    wanted = from_darks(night.darks, night.flats)
    job = night.done(services.studies.calibrations.start(wanted, user="engineer-1"))
    assert job.state == "done", job.text
    row = services.studies.calibrations.get(int(job.result["calibration_id"]))
    assert row.values["gain_e_per_dn"] == pytest.approx(5.0, rel=0.03)
    assert row.result["dark"]["hot"][0] == [200, 100]
    facts = {fact.label: fact.value for section in calibration_sheet(row).sections for fact in section.facts}
    assert facts["read noise"] == "not determined"
    assert row.result["photon_transfer"]["signal_dn"] == pytest.approx([18.0, 58.0, 118.0], abs=0.2)


def test_exports_are_readable_by_other_software(night: Night, calibrated: int) -> None:
    """A calibration is exported completely as JSON, as an ECSV table that astropy reads, and as HTML and PDF reports."""
    row = night.services.studies.calibrations.get(calibrated)
    content = json.loads(export_calibration(row, "json"))
    assert content["result"]["geometry"]["parameters"]
    text = export_calibration(row, "ecsv").decode()
    table = Table.read(text, format="ascii.ecsv")
    assert set(table.colnames) == {"name", "value", "sigma", "unit"}
    assert "focal_px" in set(table["name"])
    assert b"<svg" in export_calibration(row, "html")
    assert export_calibration(row, "pdf").startswith(b"%PDF")
    assert report_from(calibration_sheet(row).as_dict()) == calibration_sheet(row)


def test_a_camera_without_a_profile_is_calibrated_blind(night: Night) -> None:
    """A camera without a profile is calibrated from blind solutions. It cannot become a table or be used."""
    services = night.services
    wanted = from_stars(
        night.frames[:5], profile="", photometry=False, psf=False, fov_deg=float(np.degrees(TRUE.fov_rad[0]))
    )
    job = night.done(services.studies.calibrations.start(wanted, user="engineer-1"))
    assert job.state == "done", job.text
    row = services.studies.calibrations.get(int(job.result["calibration_id"]))
    camera: Camera = services.studies.calibrations.camera(row.id)
    assert abs(camera.focal_col_px / TRUE.focal_col_px - 1) < 2e-3
    with pytest.raises(BadInput, match="no profile"):
        services.studies.calibrations.table(row.id, user="engineer-1")
    with pytest.raises(BadInput, match="no profile"):
        services.studies.calibrations.use(row.id, user="engineer-1")


def test_unusable_input_is_rejected_before_it_is_queued(night: Night) -> None:
    """Unknown frames, cameras and models, and too few darks are rejected immediately. Frames without stars make the job
    fail."""
    service = night.services.studies.calibrations
    for wrong in (
        lambda: from_stars(()),
        lambda: from_stars(night.frames, models=["fisheye"]),
        lambda: from_darks(night.darks[:2]),
        lambda: from_stars((1, 1)),
    ):
        with pytest.raises(BadInput):
            wrong()
    with pytest.raises(NotFound):
        service.start(from_stars((9999,)), user="x")
    with pytest.raises(NotFound):
        service.start(from_stars(night.frames, profile="hubble"), user="x")
    job = night.done(service.start(from_stars(night.darks), user="x"))
    assert job.state == "failed"
    assert "No frame could be solved" in job.text


def test_a_measured_centre_constrains_the_camera_where_stars_do_not(night: Night) -> None:
    """With two frames, the centre is five times more accurate if a measured centre is used."""
    services = night.services
    angle = np.arange(36) * 2 * np.pi / 36
    dots = np.column_stack([TRUE.centre_col_px + 8 * np.cos(angle), TRUE.centre_row_px + 8 * np.sin(angle)])
    job = night.done(
        services.studies.calibrations.start(
            BenchCentre(kind="bench-centre", profile="cubestar", dots_px=dots.tolist()), user="x"
        )
    )
    prior_id = int(job.result["calibration_id"])

    def error_px(priors: list[int]) -> float:
        wanted = from_stars(night.frames[:2], models=["brown-2"], photometry=False, psf=False, prior_ids=priors)
        star_job = night.done(services.studies.calibrations.start(wanted, user="x"))
        camera = services.studies.calibrations.camera(int(star_job.result["calibration_id"]))
        return float(np.hypot(camera.centre_col_px - TRUE.centre_col_px, camera.centre_row_px - TRUE.centre_row_px))

    without_prior_px, with_prior_px = error_px([]), error_px([prior_id])
    assert with_prior_px < 0.2
    assert without_prior_px > 5 * with_prior_px

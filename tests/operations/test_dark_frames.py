"""Dark frames that are stored with a calibration and subtracted in ground reruns while the calibration is in use."""

from __future__ import annotations

import io
import time
from collections.abc import Iterator
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from gss.domain.errors import CorruptData
from gss.domain.frames import cam_from_icrs
from gss.instruments.registry import shipped_camera
from gss.operations.frames.dark_frames import from_bytes
from gss.operations.frames.solve import SolveRequest
from gss.operations.report.parts import Picture
from gss.operations.studies.calibration_export import export_calibration
from gss.operations.studies.calibration_requests import DetectorCalibration, StarCalibration
from gss.operations.studies.calibration_sheet import calibration_sheet
from gss.operations.studies.reprocess_worker import BatchSettings, Task, run_batch
from gss.pipeline.chip import make_chip
from gss.pipeline.render import render
from gss.settings import Settings
from gss.store.models import Calibration, Job
from gss.wiring.build import build
from gss.wiring.services import Services

SUNSAT = shipped_camera("sunsat")
WARM = 16.0
"""Factor of the dark current at 32 °C more, where fixed pattern and hot pixels dominate a frame."""
NIGHT = datetime(2026, 6, 1, tzinfo=UTC)
FRAMES = 6


class WarmServer:
    """Services with stored dark frames and star frames of one warm detector."""

    def __init__(self, folder: Path) -> None:
        self.services: Services = build(Settings(data=folder))
        self.services.base.jobs.start()
        rng = np.random.default_rng(4)
        chip = make_chip(SUNSAT.defects, SUNSAT.sensor, SUNSAT.camera, 3)
        stars = self.services.base.stars.brighter_than(7.0)
        exposure_s = SUNSAT.sensor.exposure_s
        capped = replace(SUNSAT.sensor, background_e_s=0.0)

        def image(sensor, table, attitude):  # type: ignore[no-untyped-def]
            return render(table, SUNSAT.camera, sensor, attitude, exposure_s, rng, chip=chip, dark_factor=WARM).pixels

        self.darks = tuple(self.keep(image(capped, stars.take(np.arange(0)), np.eye(3)), k) for k in range(9))
        self.attitudes = [
            cam_from_icrs(float(rng.uniform(0, 6)), float(rng.uniform(-1, 1)), 1.0) for _ in range(FRAMES)
        ]
        self.frames = tuple(self.keep(image(SUNSAT.sensor, stars, a), 20 + k) for k, a in enumerate(self.attitudes))

    def keep(self, pixels: np.ndarray, k: int) -> int:
        frame, _ = self.services.frames.frames._add(
            pixels,
            source="device",
            taken=NIGHT + timedelta(seconds=10 * k),
            bits=8,
            exposure_s=SUNSAT.sensor.exposure_s,
            profile="sunsat",
            truth=[0.0, 0.0, 0.0, 1.0],
        )
        return frame.id

    def calibrate(self, request: DetectorCalibration | StarCalibration) -> Calibration:
        job: Job = self.services.studies.calibrations.start(request, user="engineer-1")
        end = time.monotonic() + 600
        while (current := self.services.base.jobs.get(job.id)).state in (
            "queued",
            "running",
        ) and time.monotonic() < end:
            time.sleep(0.02)
        assert current.state == "done", current.text
        return self.services.studies.calibrations.get(int(current.result["calibration_id"]))

    def spots(self, chain: str = "reference") -> tuple[int, list[str]]:
        """Return the number of stars matched in all frames, and the notes of the last result."""
        matched, notes = 0, []
        for frame_id in self.frames:
            row = self.services.frames.frames.solve(
                frame_id, SolveRequest(chain=chain, profile="sunsat", exposure_s=SUNSAT.sensor.exposure_s)
            )
            matched, notes = matched + row.matched, list(row.notes)
        return matched, notes


@pytest.fixture(scope="module")
def warm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[WarmServer]:
    """Services with a warm detector, shared by the tests of this file."""
    warm_server = WarmServer(Path(tmp_path_factory.mktemp("warm")))
    yield warm_server
    warm_server.services.base.jobs.stop()
    warm_server.services.frames.frames.stop()
    warm_server.services.base.database.close()


@pytest.fixture(scope="module")
def detector(warm: WarmServer) -> Calibration:
    """Calibration of the warm detector."""
    return warm.calibrate(DetectorCalibration(kind="detector", profile="sunsat", dark_ids=list(warm.darks)))


def test_the_median_dark_frame_is_stored_and_shown(warm: WarmServer, detector: Calibration) -> None:
    """The median dark frame is stored, equal within 0.02 DN, and shown in the report as HTML and PDF. Invalid and oversized
    data are rejected."""
    stored = detector.result["dark_frame"]
    pattern = warm.services.studies.calibrations._darks.pattern(stored["key"])
    stacked = np.median(
        [warm.services.frames.frames.pixels(warm.services.frames.frames.get(i)) for i in warm.darks], axis=0
    )
    assert np.allclose(pattern.pattern_dn, stacked - np.median(stacked), atol=0.02)
    assert len(pattern.bad) == stored["bad"] > 0
    drawings = [d for s in calibration_sheet(detector).sections for d in s.drawings]
    assert any(isinstance(d, Picture) for d in drawings)
    assert b"data:image/png;base64," in export_calibration(detector, "html")
    assert b"/Image" in export_calibration(detector, "pdf")
    with pytest.raises(CorruptData):
        from_bytes(b"not a dark frame")
    bomb = io.BytesIO()
    np.savez_compressed(bomb, pattern_dn=np.zeros((12_000, 12_000), np.float16))
    with pytest.raises(CorruptData, match="when it is unpacked"):
        from_bytes(bomb.getvalue())


def test_reruns_detect_more_stars_without_the_pattern_and_report_it(warm: WarmServer, detector: Calibration) -> None:
    """Ground reruns subtract the dark frame, also in a worker process, detect more stars and report it. The sensor's chain
    gets unmodified pixels."""
    services = warm.services
    before, notes = warm.spots()
    system, _ = warm.spots("sunsat")
    assert not any("dark frame" in n for n in notes)
    services.studies.calibrations.use(detector.id, user="engineer-1")
    try:
        after, notes = warm.spots()
        assert after > 1.5 * before
        assert any(n.startswith("dark frame subtracted, ") for n in notes)
        assert warm.spots("sunsat")[0] == system
        frame = services.frames.frames.get(warm.frames[0])
        profile = replace(services.studies.calibrations.book.profile("sunsat"), sensor=SUNSAT.sensor)
        order = BatchSettings(
            services.base.settings.blobs_url, 2026.5, "reference", {"sunsat": profile}, {"sunsat": profile}
        )
        task = Task(frame.id, frame.sha256, frame.dtype, frame.rows, frame.columns, "sunsat", None)
        assert any("dark frame subtracted" in n for n in run_batch(order, [task])[0]["notes"])
    finally:
        services.studies.calibrations.use_documented("sunsat", user="engineer-1")
    assert warm.spots()[0] == before


def test_a_calibration_from_stars_inherits_the_dark_frame(warm: WarmServer, detector: Calibration) -> None:
    """A calibration from stars has the dark frame of the detector calibration in use, and keeps it when it is used."""
    service = warm.services.studies.calibrations
    request = StarCalibration(
        kind="stars", frame_ids=list(warm.frames), profile="sunsat", models=["radial-tilt"], photometry=False, psf=False
    )
    without_dark = warm.calibrate(request)
    service.use(detector.id, user="engineer-1")
    try:
        with_dark = warm.calibrate(request)
        assert "dark_frame" not in without_dark.result
        assert with_dark.result["dark_frame"] == detector.result["dark_frame"]["key"]
        assert (
            with_dark.result["geometry"]["residuals"]["stars"]
            > 1.3 * without_dark.result["geometry"]["residuals"]["stars"]
        )
        service.use(with_dark.id, user="engineer-1")
        assert service.book.dark_of("sunsat") == detector.result["dark_frame"]["key"]
        assert calibration_sheet(with_dark).sections
    finally:
        service.use_documented("sunsat", user="engineer-1")

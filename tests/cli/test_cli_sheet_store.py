"""``gss sheet`` with stored frames and telemetry of a data folder."""

from __future__ import annotations

import json
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.cli import main
from gss.domain.angles import ARCSEC_RAD
from gss.instruments.registry import shipped_camera
from gss.operations.studies.analysis_requests import SheetRequest
from gss.pipeline.sheet.unit import CALIBRATED_C, Moment, RenderedUnit, scan
from gss.settings import Settings
from gss.store.models import TelemetryPacket
from gss.wiring.build import build

CAMERA = shipped_camera("cubestar")
START = datetime(2026, 3, 1, tzinfo=UTC)
FRAMES = 16
BENDING_RAD_K = (6 * ARCSEC_RAD, -4 * ARCSEC_RAD, 0.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Data folder with the frames 1 to 16 of a head that bends with temperature, 17 to 32 of a second head, and the
    telemetry of the temperature."""
    data = Path(tmp_path_factory.mktemp("store"))
    services = build(Settings(data=data))
    sensor = CAMERA.sensor
    stars = load_stars(6.5)
    bent = RenderedUnit(CAMERA.camera, sensor, stars, sensor.exposure_s, thermal_rad_k=BENDING_RAD_K)
    still = RenderedUnit(CAMERA.camera, sensor, stars, sensor.exposure_s)
    moments = scan(FRAMES, np.random.default_rng(4))
    warm_c = [CALIBRATED_C + 10 * float(np.sin(k)) for k in range(FRAMES)]
    for unit in (bent, still):
        rng = np.random.default_rng(5)
        for k, moment in enumerate(moments):
            image = unit.frame(Moment(moment.time_s, moment.cam_from_icrs, temperature_c=warm_c[k]), rng)
            services.frames.frames._add(
                image.pixels,
                source="simulator",
                taken=START + timedelta(seconds=60 * k),
                bits=8,
                exposure_s=sensor.exposure_s,
                profile="cubestar",
            )
    with services.base.database.unit_of_work() as session:
        for k in range(FRAMES):
            at = START + timedelta(seconds=60 * k)
            values = {"sensor_temperature_c": warm_c[k]}
            session.add(
                TelemetryPacket(packet="housekeeping", received=at, device_time_s=60.0 * k, request_id=0, values=values)
            )
    services.frames.frames.stop()
    services.base.database.close()
    return data


def test_stored_frames_and_telemetry_give_the_thermo_elastic_error(
    folder: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The temperatures come from the stored telemetry, so the row of the thermo-elastic error has the bending of the head,
    and all rows are those of the page."""
    stored = ["--stored", "1-16", "--second-stored", "17-32", "--data", str(folder)]
    command = ["sheet", "--camera", "cubestar", "--chain", "reference", "--mounting", "0,0,0,1", *stored, "--json"]
    assert main(command) == 0
    figures = json.loads(capsys.readouterr().out)
    [row] = [r for r in figures["rows"] if r["key"] == "thermo-elastic"]
    assert row["measured"], row["needs"]
    for figure, true in zip(row["figures"], BENDING_RAD_K, strict=True):
        assert figure["unit"] == "arcsec/K"
        assert figure["low"] - 0.2 <= true / ARCSEC_RAD <= figure["high"] + 0.2
    services = build(Settings(data=folder))
    try:
        request = SheetRequest(
            kind="sheet",
            profile="cubestar",
            frame_ids=list(range(1, 17)),
            other_ids=list(range(17, 33)),
            other_profile="cubestar",
            mounting=[0, 0, 0, 1],
            chain="reference",
        )
        page = services.studies.analyses.sheet(request, lambda *_: None)
    finally:
        services.frames.frames.stop()
        services.base.database.close()
    assert page.figures["rows"] == figures["rows"]


def test_impossible_inputs_of_the_store_are_rejected(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Files together with stored frames, unknown frames, contacts and folders, and a wrong list of numbers are rejected."""
    start = ["sheet", "--camera", "cubestar", "--data", str(folder)]
    for words, says in (
        (["--stored", "1-3", "night.fits"], "cannot be combined"),
        (["--stored", "99"], "99"),
        (["--contact", "7"], "7"),
        (["--stored", "1", "--data", str(folder / "none")], "no such data folder"),
    ):
        assert main([*start, *words]) == 2
        assert says in capsys.readouterr().err
    with pytest.raises(SystemExit):
        main([*start, "--stored", "1-x"])
    assert "1-60,75" in capsys.readouterr().err

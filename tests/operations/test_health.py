"""Health analysis of a sensor: frames of a mission show the drift of the lens, and the proposed calibration can be used."""

from __future__ import annotations

import time
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from gss.catalogue_tools.corrections.corrections import aberrate
from gss.domain.angles import Array
from gss.domain.errors import BadInput, NotFound
from gss.domain.rotation import matrix_from_quaternion, random_quaternion
from gss.instruments.registry import shipped_camera
from gss.operations.frames.observer import observer_at
from gss.operations.frames.solve import Solver
from gss.operations.studies.analyse import AnalysisRun
from gss.operations.studies.analysis_requests import HealthRequest
from gss.operations.studies.calibration_sheet import calibration_sheet
from gss.operations.studies.night_frames import Shot
from gss.operations.studies.sensor_health import Surroundings, health_frames, orbit_within, places_below
from gss.orbit.read_orbit import read_orbits
from gss.pipeline.fixed_pattern import DarkPattern
from gss.pipeline.readout import HotPixel
from gss.pipeline.render import render
from gss.settings import Settings
from gss.store import studies as store
from gss.store.models import Analysis, Calibration, Job
from gss.wiring.build import build
from gss.wiring.services import Services

START = datetime(2026, 3, 1, tzinfo=UTC)
FRAMES, DAYS = 30, 160.0
FOCAL_SHRINKS = 8e-4
WARM = HotPixel(300, 200, 1200.0)
FULL = HotPixel(700, 90, 1e5)
"""Pixel that is saturated from the same day on."""
WARM_FROM = 12
CAMERA = shipped_camera("cubestar")
TLE = """GSS TEST
1 90001U 26001A   26060.00000000  .00000000  00000-0  00000-0 0  9993
2 90001  97.5000   0.0000 0001000   0.0000   0.0000 15.22000000    15"""

LATER = TLE.replace("26060.0", "26079.0")


def _frames(services: Services) -> list[int]:
    rng = np.random.default_rng(3)
    ids = []
    for k in range(FRAMES):
        taken = START + timedelta(days=DAYS * k / FRAMES)
        shrunk = 1 - FOCAL_SHRINKS * k / FRAMES
        lens = replace(
            CAMERA.camera,
            focal_col_px=CAMERA.camera.focal_col_px * shrunk,
            focal_row_px=CAMERA.camera.focal_row_px * shrunk,
        )
        icrs: Array = aberrate(services.base.stars.icrs, np.array(observer_at(taken).velocity_c))
        image = render(
            replace(services.base.stars, icrs=icrs),
            lens,
            CAMERA.sensor,
            matrix_from_quaternion(random_quaternion(rng)),
            CAMERA.sensor.exposure_s,
            rng,
            hot_pixels=[WARM, FULL] if k >= WARM_FROM else [],
        )
        frame, _ = services.frames.frames._add(
            image.pixels,
            source="import",
            taken=taken,
            bits=8,
            exposure_s=CAMERA.sensor.exposure_s,
            profile="cubestar",
        )
        ids.append(frame.id)
    return ids


def _done(services: Services, job: Job) -> Analysis:
    end = time.monotonic() + 600
    while (current := services.base.jobs.get(job.id)).state in ("queued", "running"):
        assert time.monotonic() < end
        time.sleep(0.05)
    assert current.state == "done", current.text
    return services.studies.analyses.get(int(current.result["analysis_id"]))


@pytest.mark.timeout(400)
def test_a_drifting_lens_and_a_warm_pixel_become_a_calibration(tmp_path: Path) -> None:
    """The report has the drift and the onset of both pixels. The proposed calibration has the final focal length and these
    pixels."""
    services = build(Settings(data=tmp_path))
    services.base.jobs.start()
    try:
        ids = _frames(services)
        request = HealthRequest(kind="health", profile="cubestar", frame_ids=ids, orbit=TLE)
        row = _done(services, services.studies.analyses.start(request, user="engineer"))
        titles = [s["title"] for s in row.result["report"]["sections"]]
        assert titles[:3] == ["Summary", "Trends", "Warm pixels"]
        assert "tolerance" in {n["code"] for n in row.result["report"]["notes"]}
        pixels = row.result["figures"]["pixels"]
        assert {(p["col"], p["row"]) for p in pixels} == {(WARM.col, WARM.row), (FULL.col, FULL.row)}
        onset = START + timedelta(days=DAYS * (WARM_FROM - 0.5) / FRAMES)
        assert all(p["onset_s"]["low"] <= onset.timestamp() <= p["onset_s"]["high"] for p in pixels)
        assert services.studies.analyses.export(row.id, "pdf").startswith(b"%PDF")
        assert b"\n300,200," in services.studies.analyses.export(row.id, "csv")

        made = services.studies.calibrations.from_health(row.id, user="engineer")
        expected = CAMERA.camera.focal_col_px * (1 - FOCAL_SHRINKS)
        assert made.values["focal_col_px"] == pytest.approx(expected, abs=0.15)
        assert [s.title for s in calibration_sheet(made).sections] == ["Health of the sensor", "Bad pixels"]
        assert calibration_sheet(made).sections[0].tables[0].rows[0][0] == "focal length"
        services.studies.calibrations.use(made.id, user="engineer")
        used = services.studies.calibrations.book.profile("cubestar")
        assert used.camera.focal_col_px == made.values["focal_col_px"]
        assert services.studies.calibrations.table(made.id, user="engineer").kind == "calibration"
        table = services.studies.calibrations.bad_pixel_table(made.id, user="engineer")
        assert (table.kind, table.content) == ("bad_pixels", {"pixels": "700,90 300,200"})
        assert services.studies.calibrations.bad_pixel_table(made.id, user="engineer").id == table.id
        frame = services.studies.analyses._shots.of(ids[-1:])[0]
        _, notes = services.studies.analyses._solver.cleaned(frame.pixels(), used, frame.exposure_s)
        assert notes == ("2 bad pixels replaced by their neighbours",)

        spatial = Analysis(kind="spatial", title="", created=START, author="", tool="", request={}, result={})
        with services.base.database.unit_of_work() as session:
            store.add_analysis(session, spatial)
        with pytest.raises(BadInput, match="proposes no calibration"):
            services.studies.calibrations.from_health(spatial.id, user="engineer")
        with pytest.raises(NotFound, match="no table of pixels"):
            services.studies.analyses.export(spatial.id, "csv")
    finally:
        services.base.jobs.stop()
        services.frames.frames.stop()
        services.base.database.close()


def test_a_sensor_without_the_table_gets_no_bad_pixel_table(tmp_path: Path) -> None:
    """The interfaces of Sagitta, OreSat and NOS3 have no bad-pixel table, so none is created."""
    services = build(Settings(data=tmp_path))
    try:
        pattern = DarkPattern(np.zeros((4, 4), np.float32), np.array([[1, 2]], np.intp), 0.1)
        for name in ("sagitta", "oresat", "nos3", "cubestar"):
            row = Calibration(
                profile=name, kind="health", name="", created=START, author="", tool="", request={}, values={}
            )
            row.result = {"dark_frame": services.frames.darks.keep_pattern(pattern)}
            with services.base.database.unit_of_work() as session:
                store.add_calibration(session, row)
            if name == "cubestar":
                assert services.studies.calibrations.bad_pixel_table(row.id, user="").content == {"pixels": "1,2"}
            else:
                with pytest.raises(BadInput, match="no bad-pixel table"):
                    services.studies.calibrations.bad_pixel_table(row.id, user="")
    finally:
        services.frames.frames.stop()
        services.base.database.close()


def test_dark_columns_are_not_part_of_the_frames_of_the_analysis() -> None:
    """The pixels of a file with dark columns have the coordinates of the camera."""
    profile = shipped_camera("sunsat")
    pixels = np.arange(profile.camera.rows * profile.camera.columns).reshape(profile.camera.rows, -1)
    dark = np.zeros((profile.camera.rows, profile.sensor.dark_columns.count), pixels.dtype)
    shot = Shot("file", START, 1.0, 8, lambda: profile.sensor.dark_columns.join(pixels, dark))
    run = AnalysisRun([shot], [None], profile)
    (frame,) = health_frames(Solver(shipped_camera), run, Surroundings())
    assert (frame.pixels() == pixels).all()


def test_the_position_is_below_the_orbit_while_it_is_defined() -> None:
    """Latitudes are within the inclination. A time long before or after the elements has no position."""
    places = places_below(orbit_within(read_orbits(TLE)))
    times = START.timestamp() + np.linspace(0, 6000, 120)
    lat, lon = places(times).T
    assert np.degrees(np.abs(lat).max()) == pytest.approx(82.5, abs=2.5)
    assert np.ptp(lon) > 1.0
    assert np.isnan(places(times[:1] - 400 * 86_400)).all()
    both = read_orbits(f"{TLE}\n{LATER}\n")
    assert [o.epoch.day for o in both] == [1, 20]
    assert np.isfinite(places_below(orbit_within(both))(times[:1] + 70 * 86_400)).all()
    assert np.isnan(places(times[:1] + 70 * 86_400)).all()

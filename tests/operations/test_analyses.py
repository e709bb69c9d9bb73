"""Analyses of rendered frames of a night reproduce the simulated parameters."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gss.catalogue_tools.sources.hipparcos import propagate
from gss.domain.errors import BadInput, NotFound
from gss.domain.frames import cam_from_icrs
from gss.instruments.registry import shipped_camera
from gss.operations.report.parts import Plot
from gss.operations.studies import analysis_sheets
from gss.operations.studies.analysis_requests import (
    FrameAnalysis,
    HealthRequest,
    MovingRequest,
    SheetRequest,
    TelemetryAnalysis,
)
from gss.operations.studies.night_frames import StoredShots, apparent_stars, request_of
from gss.pipeline.analysis.sensitivity import detection_limit
from gss.pipeline.analysis.steady import SIDEREAL_RAD_S
from gss.pipeline.render import render
from gss.settings import Settings
from gss.store.models import Analysis, Contact, Job, TelemetryPacket
from gss.wiring.build import build
from gss.wiring.services import Services

NIGHT = datetime(2026, 12, 1, 20, tzinfo=UTC)
FRAMES, STEP_S = 12, 5.0
CAMERA = shipped_camera("cubestar")


@dataclass
class AnalysisServer:
    """Services with stored frames of one night."""

    services: Services
    fixed: tuple[int, ...] = ()
    short: tuple[int, ...] = ()
    extra: list[int] = field(default_factory=list)

    def analysis_of(self, job: Job) -> Analysis:
        """Return the analysis of a job that completed."""
        end = time.monotonic() + 600
        while (current := self.services.base.jobs.get(job.id)).state in ("queued", "running"):
            assert time.monotonic() < end
            time.sleep(0.05)
        assert current.state == "done", current.text
        return self.services.studies.analyses.get(int(current.result["analysis_id"]))


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory) -> Iterator[AnalysisServer]:
    """Services with frames of a camera fixed to the Earth, twelve for each of two exposures."""
    services = build(Settings(data=Path(tmp_path_factory.mktemp("roof"))))
    services.base.jobs.start()
    stars, rng = propagate(services.base.stars, 2027.0), np.random.default_rng(7)

    def take(exposure_s: float, start_s: float) -> tuple[int, ...]:
        ids = []
        for k in range(FRAMES):
            at_s = start_s + STEP_S * k
            attitude = cam_from_icrs(1.4 + SIDEREAL_RAD_S * at_s, 0.1, 0.6)
            rate = attitude @ np.array([0.0, 0.0, SIDEREAL_RAD_S])
            image = render(stars, CAMERA.camera, CAMERA.sensor, attitude, exposure_s, rng, rate_rad_s=rate)
            frame, _ = services.frames.frames._add(
                image.pixels,
                source="import",
                taken=NIGHT + timedelta(seconds=at_s),
                bits=8,
                exposure_s=exposure_s,
                profile="cubestar",
            )
            ids.append(frame.id)
        return tuple(ids)

    yield AnalysisServer(services, take(0.25, 0.0), take(0.1, 100.0))
    services.base.jobs.stop()
    services.frames.frames.stop()
    services.base.database.close()


def of_frames(kind: Any, ids: tuple[int, ...], *, profile: str = "cubestar", **more: Any) -> FrameAnalysis:
    """Return a request for an analysis of these frames."""
    return FrameAnalysis(kind=kind, profile=profile, frame_ids=list(ids), **more)


def test_the_earth_fixed_test_measures_the_earths_rotation(server: AnalysisServer) -> None:
    """The measured rate is sidereal, the scatter is less than 5e-5 rad, and the report is exported as HTML, PDF and JSON."""
    job = server.services.studies.analyses.start(
        of_frames("earth-fixed", server.fixed, title="roof"), user="engineer-1"
    )
    row = server.analysis_of(job)
    figures = row.result["figures"]
    assert np.linalg.norm(figures["rate_icrs_rad_s"]) == pytest.approx(SIDEREAL_RAD_S, rel=0.05)
    assert figures["solved"] == FRAMES
    assert figures["body"][0]["sigma_rad"] < 5e-5
    titles = [s["title"] for s in row.result["report"]["sections"]]
    assert titles == ["Steadiness", "As right ascension, declination, rotation", "Over time", "Distribution"]
    assert b"Earth-fixed test" in server.services.studies.analyses.export(row.id, "html")
    assert server.services.studies.analyses.export(row.id, "pdf").startswith(b"%PDF")
    assert json.loads(server.services.studies.analyses.export(row.id, "json"))["figures"] == figures


def test_a_slew_is_compared_with_the_commanded_rate(server: AnalysisServer) -> None:
    """The Earth's rotation is measured as a slew of 0.004178°/s. A commanded rate of half of that gives a note."""
    start = server.services.studies.analyses.start
    right = server.analysis_of(
        start(of_frames("slew", server.fixed, commanded_deg_s=np.degrees(SIDEREAL_RAD_S)), user="x")
    )
    assert right.result["figures"]["mean_speed_rad_s"] == pytest.approx(SIDEREAL_RAD_S, rel=0.05)
    wrong = server.analysis_of(
        start(of_frames("slew", server.fixed, commanded_deg_s=np.degrees(SIDEREAL_RAD_S) / 2), user="x")
    )
    assert "rate" in {n["code"] for n in wrong.result["report"]["notes"]}


def test_a_limit_below_which_half_is_missed_is_not_determined() -> None:
    """If at most half of the bright stars are detected, no magnitude has a share of one half, which the report states."""
    rng = np.random.default_rng(3)
    v_mag = rng.uniform(2, 8, 1000)
    result = detection_limit(v_mag, rng.random(1000) < 0.4 / (1 + np.exp(3 * (v_mag - 5.5))))
    report = analysis_sheets.sensitivity(result, CAMERA, "night")
    assert np.isnan([result.mag_50, result.sigma_50]).all()
    assert report.sections[0].facts[0].value == "not determined"
    curve = report.sections[0].drawings[0]
    assert isinstance(curve, Plot)
    assert [level.label for level in curve.levels] == ["profile"]


def test_sensitivity_noise_and_spatial_error(server: AnalysisServer) -> None:
    """The limiting magnitude is close to the camera's, noise is reported for two exposures, and residuals are mapped."""
    start = server.services.studies.analyses.start
    limit = server.analysis_of(start(of_frames("sensitivity", server.fixed), user="x"))
    figures = limit.result["figures"]
    assert CAMERA.sensor.faint_limit_mag < figures["mag_90"] < figures["mag_50"] < 6.5
    assert limit.result["report"]["notes"] == []
    curve = server.analysis_of(start(of_frames("nea", server.fixed + server.short), user="x"))
    assert curve.result["figures"]["exposure_s"] == [0.1, 0.25]
    spatial = server.analysis_of(start(of_frames("spatial", server.fixed), user="x"))
    assert 0 < spatial.result["figures"]["rms_px"] < 0.5


def test_two_cameras_and_the_replicas_chain(server: AnalysisServer) -> None:
    """The same frames as those of a second camera give a mounting rotation of zero."""
    request = of_frames(
        "two-cameras", server.fixed, chain="cubestar", other_profile="cubestar", other_ids=list(server.fixed)
    )
    row = server.analysis_of(server.services.studies.analyses.start(request, user="x"))
    assert abs(row.result["figures"]["second_from_first"][3]) == pytest.approx(1)


def test_telemetry_alone_is_enough(server: AnalysisServer) -> None:
    """Attitude packets of a contact give noise and availability. For a contact without packets the analysis fails."""
    rng = np.random.default_rng(2)
    with server.services.base.database.unit_of_work() as session:
        contact = Contact(url="test", started=NIGHT, ended=NIGHT + timedelta(seconds=300))
        empty = Contact(url="test", started=NIGHT, ended=NIGHT + timedelta(seconds=300))
        session.add_all([contact, empty])
        session.flush()
        for k in range(200):
            q = np.array([*(rng.normal(size=3) * 2.5e-5), 1.0])
            values = dict(
                zip(("quaternion_x", "quaternion_y", "quaternion_z", "quaternion_w"), q.tolist(), strict=True)
            )
            values |= {
                "frame_time_s": float(k),
                "outcome": "none" if k % 50 == 7 else "solved",
                "centroids": 14,
                "matched": 12,
            }
            values |= {"sigma_cross_arcsec": 10.0, "sigma_roll_arcsec": 10.0}
            session.add(
                TelemetryPacket(
                    contact_id=contact.id,
                    packet="attitude",
                    received=NIGHT + timedelta(seconds=k),
                    device_time_s=float(k),
                    request_id=0,
                    values=values,
                )
            )
    row = server.analysis_of(
        server.services.studies.analyses.start(TelemetryAnalysis(kind="telemetry", contact=contact.id), user="x")
    )
    assert row.result["figures"]["noise_rad"] == pytest.approx([5e-5] * 3, rel=0.2)
    assert row.result["figures"]["availability"] == pytest.approx(0.98)
    job = server.services.studies.analyses.start(TelemetryAnalysis(kind="telemetry", contact=empty.id), user="x")
    with pytest.raises(AssertionError, match="no attitudes"):
        server.analysis_of(job)


def test_impossible_analyses_are_rejected(server: AnalysisServer) -> None:
    """Incomplete requests, unknown frames and unknown contacts are rejected immediately. With a camera that did not take
    the frames, the job fails."""
    service = server.services.studies.analyses
    for wrong in (
        lambda: of_frames("slew", server.fixed),
        lambda: of_frames("two-cameras", server.fixed),
        lambda: of_frames("earth-fixed", ()),
        lambda: of_frames("earth-fixed", server.fixed, chain="cassini"),
    ):
        with pytest.raises(BadInput):
            wrong()
    with pytest.raises(NotFound):
        service.start(of_frames("earth-fixed", (9999,)), user="x")
    with pytest.raises(NotFound):
        service.start(TelemetryAnalysis(kind="telemetry", contact=9999), user="x")
    job = service.start(of_frames("earth-fixed", server.fixed, profile="sunsat"), user="x")
    with pytest.raises(AssertionError, match="No frame could be solved"):
        server.analysis_of(job)


def test_frames_with_an_unknown_time_are_analysed_without_it(server: AnalysisServer) -> None:
    """Analyses over time reject a frame that has only the time of its import. Others use the stars of the solver's epoch,
    as the result of the frame does, and do not state a time."""
    services, service = server.services, server.services.studies.analyses
    later = NIGHT.replace(year=2100)
    pixels = services.frames.frames.pixels(services.frames.frames.get(server.fixed[0]))
    frame, _ = services.frames.frames._add(
        pixels, source="import", taken=later, time_known=False, bits=8, exposure_s=0.25, profile="cubestar"
    )
    ids = (*server.fixed[:2], frame.id)
    timed = of_frames("two-cameras", server.fixed, other_profile="cubestar", other_ids=[frame.id])
    for request in (
        *(of_frames(kind, ids) for kind in ("earth-fixed", "celestial-fixed", "nea")),
        of_frames("slew", ids, commanded_deg_s=1.0),
        timed,
        SheetRequest(kind="sheet", profile="cubestar", frame_ids=list(ids)),
        MovingRequest(kind="moving", profile="cubestar", frame_ids=list(ids)),
        HealthRequest(kind="health", profile="cubestar", frame_ids=list(ids)),
    ):
        with pytest.raises(BadInput, match=f"frame {frame.id} has only the time of its import"):
            service.start(request, user="x")
    row = server.analysis_of(service.start(of_frames("spatial", ids), user="x"))
    assert ", time unknown, chain" in row.result["report"]["subtitle"]
    (shot,) = StoredShots(services.base.database, services.frames.frames).of([frame.id])
    assert request_of(shot, CAMERA, None, "reference").epoch_jyear is None
    assert apparent_stars(services.frames.solver, shot) is services.frames.solver.stars(None)


def test_a_performance_sheet_of_a_night_states_what_it_lacks(server: AnalysisServer) -> None:
    """Rows that can be measured from these frames have intervals. The others state which data they need."""
    request = SheetRequest(kind="sheet", profile="cubestar", frame_ids=list(server.fixed), title="unit 1")
    row = server.analysis_of(server.services.studies.analyses.start(request, user="engineer-1"))
    rows = {r["key"]: r for r in row.result["figures"]["rows"]}
    assert rows["acquisition"]["measured"]
    assert rows["acquisition"]["figures"][0]["value"] == 100
    assert rows["acquisition"]["figures"][0]["low"] < 100
    assert "second head" in rows["bias"]["needs"]
    assert all(r["needs"] for r in rows.values() if not r["measured"])
    assert row.result["figures"]["source"] == "frames"
    assert row.result["figures"]["chain"] == "cubestar"
    assert server.services.studies.analyses.export(row.id, "pdf").startswith(b"%PDF")
    assert b"Thermo-elastic error" in server.services.studies.analyses.export(row.id, "html")


def test_a_night_without_satellites_has_no_moving_objects(server: AnalysisServer) -> None:
    """Frames without satellites give no tracks, and the TDM has a header only. Other analyses have no TDM."""
    request = MovingRequest(kind="moving", profile="cubestar", frame_ids=list(server.fixed), site=[48.0, 11.0, 500.0])
    row = server.analysis_of(server.services.studies.analyses.start(request, user="x"))
    assert row.result["figures"]["tracks"] == []
    assert row.result["figures"]["used"] == FRAMES
    assert server.services.studies.analyses.export(row.id, "tdm").startswith(b"CCSDS_TDM_VERS = 2.0")
    other = server.analysis_of(server.services.studies.analyses.start(of_frames("spatial", server.fixed), user="x"))
    with pytest.raises(NotFound, match="no tracking data"):
        server.services.studies.analyses.export(other.id, "tdm")


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({"objects": "1 2 3"}, "list of objects"),
        ({"orbit": "nothing"}, "two-line element set"),
        ({"orbit": "x", "site": [0.0, 0.0, 0.0]}, "two positions"),
        ({"site": [91.0, 0.0, 0.0]}, "latitude"),
        ({"chain": "cassini"}, "unknown chain"),
        ({"frame_ids": [1, 1]}, "different frames"),
    ],
)
def test_impossible_searches_are_rejected(more: dict[str, Any], words: str) -> None:
    """A search with invalid elements, positions, chain or frames is rejected."""
    with pytest.raises(BadInput, match=words):
        MovingRequest(**{"kind": "moving", "profile": "cubestar", "frame_ids": [1], **more})


@pytest.mark.parametrize(
    ("more", "words"),
    [
        ({}, "frames, a simulated unit or a contact"),
        ({"simulated": True, "frame_ids": [1]}, "frames, a simulated unit or a contact"),
        ({"simulated": True, "contact": 1}, "frames, a simulated unit or a contact"),
        ({"contact": 1, "other_ids": [2], "other_profile": "cubestar"}, "second head"),
        ({"frame_ids": [1, 1]}, "frames cannot be used"),
        ({"frame_ids": [1], "other_ids": [2]}, "second head"),
        ({"frame_ids": [1], "mounting": [0.5, 0.0, 0.0, 0.0]}, "unit quaternion"),
        ({"frame_ids": [1], "chain": "no-such-chain"}, "unknown chain"),
    ],
)
def test_impossible_sheets_are_rejected(more: dict[str, Any], words: str) -> None:
    """A contradictory request for a performance sheet is rejected."""
    with pytest.raises(BadInput, match=words):
        SheetRequest(kind="sheet", profile="cubestar", **more)

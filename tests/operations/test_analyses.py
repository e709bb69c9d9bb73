"""Analyses as use cases: a night of rendered frames becomes the figures that were put in."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from pathlib import Path

import numpy as np
import pytest

from gss.catalogue_tools.sources.hipparcos import propagate
from gss.domain.errors import BadInput, NotFound
from gss.domain.frames import cam_from_icrs
from gss.domain.profiles import profile
from gss.operations.studies.analyses import FrameAnalysis, TelemetryAnalysis
from gss.pipeline.analysis.steady import SIDEREAL_RAD_S
from gss.pipeline.render import render
from gss.settings import Settings
from gss.store.models import Analysis, Contact, Job, TelemetryPacket
from gss.wiring import Services, build

NIGHT = datetime(2026, 12, 1, 20, tzinfo=UTC)
FRAMES, STEP_S = 12, 5.0
CAMERA = profile("cubestar")


@dataclass
class Roof:
    """A server's objects with a night on the roof in the store."""

    services: Services
    fixed: tuple[int, ...] = ()
    short: tuple[int, ...] = ()
    extra: list[int] = field(default_factory=list)

    def made(self, job: Job) -> Analysis:
        """The analysis of a job that ended well."""
        end = time.monotonic() + 60
        while (now := self.services.jobs.get(job.id)).state in ("queued", "running"):
            assert time.monotonic() < end
            time.sleep(0.05)
        assert now.state == "done", now.text
        return self.services.analyses.get(int(now.result["analysis_id"]))


@pytest.fixture(scope="module")
def roof(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Roof]:
    """A camera fixed to the Earth, twelve frames at each of two exposures."""
    services = build(Settings(data=Path(tmp_path_factory.mktemp("roof"))))
    services.jobs.start()
    stars, rng = propagate(services.stars, 2027.0), np.random.default_rng(7)

    def take(exposure_s: float, start_s: float) -> tuple[int, ...]:
        ids = []
        for k in range(FRAMES):
            at_s = start_s + STEP_S * k
            attitude = cam_from_icrs(1.4 + SIDEREAL_RAD_S * at_s, 0.1, 0.6)
            rate = attitude @ np.array([0.0, 0.0, SIDEREAL_RAD_S])
            image = render(stars, CAMERA.camera, CAMERA.sensor, attitude, exposure_s, rng, rate_rad_s=rate)
            frame = services.frames._add(
                image.pixels,
                source="import",
                taken=NIGHT + timedelta(seconds=at_s),
                bits=8,
                exposure_s=exposure_s,
                profile="cubestar",
            )
            ids.append(frame.id)
        return tuple(ids)

    yield Roof(services, take(0.25, 0.0), take(0.1, 100.0))
    services.jobs.stop()
    services.frames.stop()
    services.database.close()


def test_the_earth_fixed_test_finds_the_turning_earth(roof: Roof) -> None:
    """The turn is the sidereal one, the scatter arcseconds, and the report says so in words, plots and tables."""
    job = roof.services.analyses.start(FrameAnalysis("earth-fixed", "cubestar", roof.fixed), "roof", user="engineer-1")
    row = roof.made(job)
    figures = row.result["figures"]
    assert np.linalg.norm(figures["rate_icrs_rad_s"]) == pytest.approx(SIDEREAL_RAD_S, rel=0.05)
    assert figures["solved"] == FRAMES
    assert figures["body"][0]["sigma_rad"] < 5e-5
    titles = [s["title"] for s in row.result["report"]["sections"]]
    assert titles == ["Steadiness", "As right ascension, declination, rotation", "Over time", "Distribution"]
    assert b"Earth-fixed test" in roof.services.analyses.export(row.id, "html")
    assert roof.services.analyses.export(row.id, "pdf").startswith(b"%PDF")
    assert json.loads(roof.services.analyses.export(row.id, "json"))["figures"] == figures


def test_a_slew_at_the_sidereal_rate_and_a_wrong_one(roof: Roof) -> None:
    """The Earth's own turn as a slew of 0.004178°/s agrees; half of it is doubted."""
    start = roof.services.analyses.start
    right = roof.made(start(FrameAnalysis("slew", "cubestar", roof.fixed, "reference", SIDEREAL_RAD_S), "", user="x"))
    assert right.result["figures"]["mean_speed_rad_s"] == pytest.approx(SIDEREAL_RAD_S, rel=0.05)
    wrong = roof.made(
        start(FrameAnalysis("slew", "cubestar", roof.fixed, "reference", SIDEREAL_RAD_S / 2), "", user="x")
    )
    assert "rate" in {n["code"] for n in wrong.result["report"]["notes"]}


def test_sensitivity_noise_and_spatial_error(roof: Roof) -> None:
    """The limit is near the camera's, noise is told for two exposures, residuals are mapped."""
    start = roof.services.analyses.start
    limit = roof.made(start(FrameAnalysis("sensitivity", "cubestar", roof.fixed), "", user="x"))
    figures = limit.result["figures"]
    assert CAMERA.sensor.faint_limit_mag < figures["mag_90"] < figures["mag_50"] < 6.5
    assert limit.result["report"]["notes"] == []
    curve = roof.made(start(FrameAnalysis("nea", "cubestar", roof.fixed + roof.short), "", user="x"))
    assert curve.result["figures"]["exposure_s"] == [0.1, 0.25]
    spatial = roof.made(start(FrameAnalysis("spatial", "cubestar", roof.fixed), "", user="x"))
    assert 0 < spatial.result["figures"]["rms_px"] < 0.5


def test_two_cameras_and_the_replicas_chain(roof: Roof) -> None:
    """The same frames by another chain as a second camera: the mounting is no turn at all."""
    wanted = FrameAnalysis("two-cameras", "cubestar", roof.fixed, "cubestar", None, "cubestar", roof.fixed)
    row = roof.made(roof.services.analyses.start(wanted, "", user="x"))
    assert abs(row.result["figures"]["second_from_first"][3]) == pytest.approx(1)


def test_telemetry_alone_is_enough(roof: Roof) -> None:
    """Attitude packets of a contact give noise and availability; a contact without any is told."""
    rng = np.random.default_rng(2)
    with roof.services.database.unit_of_work() as session:
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
    row = roof.made(roof.services.analyses.start(TelemetryAnalysis(contact.id), "", user="x"))
    assert row.result["figures"]["noise_rad"] == pytest.approx([5e-5] * 3, rel=0.2)
    assert row.result["figures"]["availability"] == pytest.approx(0.98)
    job = roof.services.analyses.start(TelemetryAnalysis(empty.id), "", user="x")
    with pytest.raises(AssertionError, match="no attitudes"):
        roof.made(job)


def test_what_cannot_be_analysed_is_told(roof: Roof) -> None:
    """Wrong kinds, missing rates, unknown frames and cameras at once; a camera that is not these frames' by the job."""
    service = roof.services.analyses
    for wrong in (
        lambda: FrameAnalysis("astrology", "cubestar", roof.fixed),
        lambda: FrameAnalysis("slew", "cubestar", roof.fixed),
        lambda: FrameAnalysis("two-cameras", "cubestar", roof.fixed),
        lambda: FrameAnalysis("earth-fixed", "cubestar", ()),
        lambda: FrameAnalysis("earth-fixed", "cubestar", roof.fixed, "cassini"),
    ):
        with pytest.raises(BadInput):
            wrong()
    with pytest.raises(NotFound):
        service.start(FrameAnalysis("earth-fixed", "cubestar", (9999,)), "", user="x")
    with pytest.raises(NotFound):
        service.start(TelemetryAnalysis(9999), "", user="x")
    job = service.start(replace(FrameAnalysis("earth-fixed", "sunsat", roof.fixed)), "", user="x")
    with pytest.raises(AssertionError, match="no frame could be solved"):
        roof.made(job)

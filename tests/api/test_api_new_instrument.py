"""Instruments from photographs over HTTP: the job, the numbers with their uncertainty, and rejected requests."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from gss.catalogue_tools.sources.hipparcos import propagate
from gss.domain.camera import Brown, Camera
from gss.domain.frames import cam_from_icrs
from gss.domain.sensor import Sensor
from gss.instruments.registry import shipped_camera
from gss.operations.clock import utc_now
from gss.operations.frames.observer import epoch_at
from gss.pipeline.render import render
from gss.settings import Settings
from gss.wiring.build import build
from gss.wiring.services import Services

PATH = "/api/instruments/photographs"
TRUE = Camera(480, 360, 1003.0, 1002.0, 245.0, 175.0, Brown(-0.12))
SENSOR = replace(
    shipped_camera("cubestar").sensor,
    bits=12,
    gain_e_per_dn=4.0,
    bias_dn=100.0,
    read_noise_e=12.0,
    dark_current_e_s=0.0,
    background_e_s=900.0,
    full_well_e=16_000.0,
    zero_point_e_s=1.5e6,
    psf_sigma_px=0.9,
)
EXPOSURES_S = (0.2, 0.5, 0.8)
FACTS = {"format": "FITS", "pixel_um": "5.5"}


@dataclass(frozen=True)
class Server:
    """A server with photographs of one camera, three images without stars, and one of another size."""

    services: Services
    client: TestClient
    viewer: TestClient
    sky: list[int]
    empty: list[int]
    other: int

    def run_job(self, body: dict[str, Any]) -> dict[str, Any]:
        """Start a job and return it after its end."""
        started = self.client.post(PATH, json=body)
        assert started.status_code == 202, started.text
        end, job = time.monotonic() + 400, started.json()
        while job["state"] in ("queued", "running"):
            assert time.monotonic() < end, job
            time.sleep(0.2)
            job = self.client.get(f"/api/jobs/{job['id']}").json()
        return dict(job)


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory, client_of: Callable[..., TestClient]) -> Iterator[Server]:
    services = build(Settings(data=tmp_path_factory.mktemp("data")))
    stars = propagate(services.base.stars.brighter_than(8.0), epoch_at(utc_now()))
    rng = np.random.default_rng(11)

    def store_frame(pixels: np.ndarray, exposure_s: float = 0.5) -> int:
        facts = {"bits": 12, "exposure_s": exposure_s, "profile": None, "parameters": {"file": FACTS}}
        frame, _ = services.frames.frames._add(pixels, source="import", name="roof.fits", taken=utc_now(), **facts)
        return frame.id

    def photograph(exposure_s: float, sensor: Sensor = SENSOR) -> np.ndarray:
        attitude = cam_from_icrs(rng.uniform(0, 6.28), np.arcsin(rng.uniform(-1, 1)), rng.uniform(0, 6.28))
        return np.asarray(render(stars, TRUE, sensor, attitude, exposure_s, rng).pixels)

    sky = [store_frame(photograph(t), t) for t in EXPOSURES_S]
    empty = [store_frame(rng.normal(200, 5, (360, 480)).astype(np.uint16)) for _ in range(3)]
    other = store_frame(rng.normal(200, 5, (300, 480)).astype(np.uint16))
    with client_of(services) as admin:
        yield Server(services, admin, client_of(services, name="vera", role="viewer"), sky, empty, other)


def test_an_instrument_is_made_from_photographs(server: Server) -> None:
    """The true numbers lie within four of the stated standard deviations, and each number states its frames. The
    installed package solves the photographs. Other images are skipped with a reason. The name cannot be used again.
    """
    body = {"name": "roof", "frame_ids": [*server.sky, server.empty[0], server.other], "atmosphere": False}
    job = server.run_job(body | {"fov_min_deg": 24.0, "fov_max_deg": 30.0})
    assert job["state"] == "done", job
    result = job["result"]
    rows = {int(r["name"].split()[-1].strip(")")): r for r in result["photographs"]}
    assert [k for k, r in rows.items() if r["used"]] == server.sky
    assert "not the night sky" in rows[server.empty[0]]["reason"]
    assert "480 x 300 px; 4 others are 480 x 360 px" in rows[server.other]["reason"]
    assert [t["solved"] for t in result["trials"]] == [True] * 3
    shown = server.client.get("/api/instruments/roof").json()
    numbers = {n["name"]: n for n in shown["numbers"]}
    truth = {
        "focal_length": TRUE.focal_col_px * 0.0055,
        "pitch_row": 0.0055 * TRUE.focal_col_px / TRUE.focal_row_px,
        "centre_column": TRUE.centre_col_px,
        "centre_row": TRUE.centre_row_px,
        "k1": -0.12,
        "psf_sigma": SENSOR.psf_sigma_px,
        "gain": SENSOR.gain_e_per_dn,
        "bias": SENSOR.bias_dn + SENSOR.background_e_s * EXPOSURES_S[0] / SENSOR.gain_e_per_dn,
        "zero_point": SENSOR.zero_point_e_s,
    }
    for name, value in truth.items():
        number = numbers[name]
        assert number["source"].startswith("photographs: 3 frames, "), name
        assert 0 < number["sigma"] < 0.15 * abs(value) + 1e-9, (name, number)
        assert abs(number["values"][0] - value) < 4 * number["sigma"], (name, number, value)
    assert 5.5 < numbers["faintest"]["values"][0] < 8
    assert numbers["pitch_column"]["chosen"] == "pixel size as stated by the user or the files"
    again = server.client.post(PATH, json=body)
    assert again.status_code == 409, again.text
    assert "An instrument of this name exists" in again.text


def test_unusable_photographs_are_rejected_with_reasons(server: Server) -> None:
    """With fewer than three usable photographs the job fails, names the reason of each, and installs nothing."""
    job = server.run_job({"name": "nothing", "frame_ids": [*server.empty, server.other]})
    assert job["state"] == "failed"
    assert "at least 3 photographs of one camera" in job["text"]
    assert job["text"].count("not the night sky") == 3
    assert f"frame {server.other}" in job["text"]
    assert not server.services.base.instruments.has("nothing")


@pytest.mark.parametrize(
    ("change", "status", "words"),
    [
        ({"name": "cubestar"}, 409, "exists"),
        ({"name": "No Name"}, 422, "name"),
        ({"model": "nosuch"}, 404, "Unknown instrument"),
        ({"frame_ids": [1, 2]}, 422, "at least 3"),
        ({"frame_ids": [1, 1, 2]}, 422, "occurs twice"),
        ({"frame_ids": [1, 2, 9999]}, 404, "frame"),
        ({"fov_min_deg": 20.0}, 422, "belong together"),
        ({"fov_min_deg": 20.0, "fov_max_deg": 10.0}, 422, "larger"),
        ({"date": "2026-13-01"}, 422, "date"),
        ({"date": "1066-10-14"}, 422, "date must be between"),
    ],
)
def test_bad_requests_are_rejected_before_anything_is_queued(
    server: Server, change: dict[str, Any], status: int, words: str
) -> None:
    """Each invalid request is rejected with its reason, and no job is created."""
    jobs = len(server.client.get("/api/jobs").json())
    answer = server.client.post(PATH, json={"name": "roof2", "frame_ids": server.empty} | change)
    assert (answer.status_code, words in answer.text) == (status, True), answer.text
    assert len(server.client.get("/api/jobs").json()) == jobs


def test_a_viewer_cannot_make_an_instrument(server: Server) -> None:
    """A viewer lacks the permission, as for the upload of a package."""
    assert server.viewer.post(PATH, json={"name": "mine", "frame_ids": server.empty}).status_code == 403

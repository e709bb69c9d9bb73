"""Laboratory calibrations over HTTP: requests, stored versions with reports, and use as prior of a star calibration."""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

import numpy as np
from fastapi.testclient import TestClient

from gss.instruments.registry import shipped_camera
from gss.operations.frames.pictures import png
from gss.operations.studies.bench import priors_of
from gss.pipeline.second_lens import SecondLens, through_second_lens

ANGLE = np.arange(24) * 2 * np.pi / 24
DOTS = np.column_stack([541.5 + 9 * np.cos(ANGLE), 243.25 + 9 * np.sin(ANGLE)])


def create_calibration(client: TestClient, body: dict[str, Any]) -> dict[str, Any]:
    """Request a calibration, wait for its job, and return the created version."""
    reply = client.post("/api/calibrations", json=body)
    assert reply.status_code == 202, reply.text
    job, end = reply.json(), time.monotonic() + 30
    while job["state"] in ("queued", "running") and time.monotonic() < end:
        time.sleep(0.02)
        job = next(j for j in client.get("/api/jobs").json() if j["id"] == job["id"])
    assert job["state"] == "done", job["text"]
    return dict(client.get(f"/api/calibrations/{job['result']['calibration_id']}").json())


def test_a_measured_spot_becomes_a_version_with_a_report(client: TestClient) -> None:
    """Measured dots give a version with the centre. It cannot become a sensor table, because it is only part of a
    camera.
    """
    version = create_calibration(client, {"kind": "bench-centre", "profile": "cubestar", "dots_px": DOTS.tolist()})
    assert version["kind"] == "bench-centre"
    assert abs(version["result"]["centre"]["col_px"] - 541.5) < 1e-3
    assert not version["sendable"]
    assert version["report"]["sections"][0]["drawings"][0]["kind"] == "plot"
    for kind in ("json", "html", "pdf"):
        assert client.get(f"/api/calibrations/{version['id']}/export?kind={kind}").status_code == 200
    for action in ("use", "table"):
        rejected = client.post(f"/api/calibrations/{version['id']}/{action}")
        assert rejected.status_code == 400
        assert "prior" in rejected.json()["hint"]
    other = create_calibration(client, {"kind": "bench-centre", "profile": "cubestar", "dots_px": (DOTS + 1).tolist()})
    reply = client.get(f"/api/calibrations/diff?older={version['id']}&newer={other['id']}")
    assert reply.status_code == 400
    assert "part of a camera" in reply.json()["message"]


def test_pictures_through_a_second_lens_become_a_prior(client: TestClient) -> None:
    """Imported pictures give a version with the principal point of the rendered camera, which priors accept. A frame
    without a circle of light fails with the reason.
    """
    profile = shipped_camera("cubestar")
    camera = replace(profile.camera, centre_col_px=530.0, centre_row_px=240.0)
    picture = through_second_lens(camera, profile.sensor, SecondLens(0.05), np.random.default_rng(3))
    frames = []
    for name, pixels in (("circle.png", picture), ("even.png", np.full_like(picture, 9))):
        files = {"file": (name, png(pixels), "image/png")}
        frames.append(client.post("/api/frames/import", files=files, data={"profile": "cubestar"}).json()["id"])
    body = {"kind": "bench-second-lens", "profile": "cubestar", "frame_ids": frames[:1]}
    version = create_calibration(client, body)
    point = version["result"]["second_lens"]
    assert abs(point["col_px"] - 530.0) < 3 * point["sigma_px"]
    assert abs(point["row_px"] - 240.0) < 3 * point["sigma_px"]
    assert version["report"]["sections"][0]["title"] == "Principal point from a second lens"
    priors = priors_of([("bench-second-lens", version["result"])])
    assert priors["centre_col_px"].value == point["col_px"]
    reply = client.post("/api/calibrations", json=body | {"frame_ids": frames[1:]})
    job, end = reply.json(), time.monotonic() + 30
    while job["state"] in ("queued", "running") and time.monotonic() < end:
        time.sleep(0.02)
        job = next(j for j in client.get("/api/jobs").json() if j["id"] == job["id"])
    assert job["state"] == "failed"
    assert "circle of light" in job["text"].lower()


def test_laboratory_tables_are_typed(client: TestClient) -> None:
    """Dark-current laws and focus widths are accepted. Rows of a wrong length, unknown cameras and empty requests are
    rejected.
    """
    law = create_calibration(
        client,
        {"kind": "bench-dark-law", "profile": "cubestar", "points": [[0, 10], [10, 24], [20, 57], [30, 130]]},
    )
    assert 6 < law["result"]["dark_law"]["doubling_k"] < 11
    run = create_calibration(
        client,
        {"kind": "bench-focus", "profile": "cubestar", "widths": [[0, 1.5], [1, 0.9], [2, 0.6], [3, 0.9], [4, 1.5]]},
    )
    assert abs(run["result"]["focus_run"]["position"] - 2) < 0.05
    for body, status in (
        ({"kind": "bench-centre", "profile": "cubestar", "dots_px": [[1, 2, 3]]}, 422),
        ({"kind": "bench-centre", "profile": "hubble", "dots_px": [[1, 2]]}, 404),
        ({"kind": "bench-focus", "profile": "cubestar"}, 400),
        ({"kind": "bench-tilt", "profile": "", "pairs_px": [[1, 2, 3, 4]]}, 400),
        ({"kind": "bench-focal", "profile": "cubestar", "frame_ids": [999]}, 404),
        ({"kind": "bench-checkerboard", "profile": "", "frame_ids": [1], "corners": [9], "square_mm": 1}, 422),
    ):
        assert client.post("/api/calibrations", json=body).status_code in (status, 400, 422), body


def test_only_matching_measurements_are_used_as_prior(client: TestClient) -> None:
    """A dark-current law does not constrain the geometry, and another camera's centre does not constrain this one."""
    law = create_calibration(
        client, {"kind": "bench-dark-law", "profile": "cubestar", "points": [[0, 10], [10, 24], [20, 57]]}
    )
    other_camera = create_calibration(client, {"kind": "bench-centre", "profile": "sunsat", "dots_px": DOTS.tolist()})
    pixels = np.zeros((512, 1024), np.uint8)
    import io

    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, format="PNG")
    files = {"file": ("dark.png", buffer.getvalue(), "image/png")}
    frame = client.post("/api/frames/import", files=files, data={"profile": "cubestar"}).json()["id"]
    for prior, words in ((law["id"], "cannot be used as a prior"), (other_camera["id"], "another camera")):
        body = {"kind": "stars", "profile": "cubestar", "frame_ids": [frame], "prior_ids": [prior]}
        reply = client.post("/api/calibrations", json=body)
        assert reply.status_code == 400
        assert words in reply.json()["message"]

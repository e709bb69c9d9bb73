"""Laboratory calibrations over HTTP: typed bodies in, versions with a report out, and their use in a calibration from
stars.
"""

from __future__ import annotations

import time
from typing import Any

import numpy as np
from fastapi.testclient import TestClient

ANGLE = np.arange(24) * 2 * np.pi / 24
DOTS = np.column_stack([541.5 + 9 * np.cos(ANGLE), 243.25 + 9 * np.sin(ANGLE)])


def calibration(client: TestClient, body: dict[str, Any]) -> dict[str, Any]:
    """Return the version that a request creates."""
    reply = client.post("/api/calibrations", json=body)
    assert reply.status_code == 202, reply.text
    job, end = reply.json(), time.monotonic() + 30
    while job["state"] in ("queued", "running") and time.monotonic() < end:
        time.sleep(0.02)
        job = next(j for j in client.get("/api/jobs").json() if j["id"] == job["id"])
    assert job["state"] == "done", job["text"]
    return dict(client.get(f"/api/calibrations/{job['result']['calibration_id']}").json())


def test_a_measured_spot_becomes_a_version_with_a_report(client: TestClient) -> None:
    """The centre with its circle; no sensor table, because the centre is only one part of a camera."""
    made = calibration(client, {"kind": "bench-centre", "profile": "cubestar", "dots_px": DOTS.tolist()})
    assert made["kind"] == "bench-centre"
    assert abs(made["result"]["centre"]["col_px"] - 541.5) < 1e-3
    assert not made["sendable"]
    assert made["report"]["sections"][0]["drawings"][0]["kind"] == "plot"
    for kind in ("json", "html", "pdf"):
        assert client.get(f"/api/calibrations/{made['id']}/export?kind={kind}").status_code == 200
    for action in ("use", "table"):
        refused = client.post(f"/api/calibrations/{made['id']}/{action}")
        assert refused.status_code == 400
        assert "prior" in refused.json()["hint"]
    other = calibration(client, {"kind": "bench-centre", "profile": "cubestar", "dots_px": (DOTS + 1).tolist()})
    reply = client.get(f"/api/calibrations/diff?older={made['id']}&newer={other['id']}")
    assert reply.status_code == 400
    assert "part of a camera" in reply.json()["message"]


def test_laboratory_tables_are_typed(client: TestClient) -> None:
    """Dark-current law and focus widths are accepted; rows of another length, unknown cameras and empty requests are
    rejected.
    """
    law = calibration(
        client,
        {"kind": "bench-dark-law", "profile": "cubestar", "points": [[0, 10], [10, 24], [20, 57], [30, 130]]},
    )
    assert 6 < law["result"]["dark_law"]["doubling_k"] < 11
    run = calibration(
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
    law = calibration(
        client, {"kind": "bench-dark-law", "profile": "cubestar", "points": [[0, 10], [10, 24], [20, 57]]}
    )
    far = calibration(client, {"kind": "bench-centre", "profile": "sunsat", "dots_px": DOTS.tolist()})
    pixels = np.zeros((512, 1024), np.uint8)
    import io

    from PIL import Image

    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, format="PNG")
    files = {"file": ("dark.png", buffer.getvalue(), "image/png")}
    frame = client.post("/api/frames/import", files=files, data={"profile": "cubestar"}).json()["id"]
    for prior, words in ((law["id"], "cannot be used as a prior"), (far["id"], "another camera")):
        body = {"kind": "stars", "profile": "cubestar", "frame_ids": [frame], "prior_ids": [prior]}
        reply = client.post("/api/calibrations", json=body)
        assert reply.status_code == 400
        assert words in reply.json()["message"]

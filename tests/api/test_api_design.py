"""Design studies over HTTP."""

from __future__ import annotations

import json
import time
from typing import Any

import pytest
from fastapi.testclient import TestClient


def test_cameras_are_listed_with_limits_sources_and_rows(client: TestClient) -> None:
    """The response has the initial values of the form: all cameras with their numbers, the range of each field, and the
    rows of the table.
    """
    answer = client.get("/api/design/cameras").json()
    assert [c["name"] for c in answer["cameras"]] == [
        "aim",
        "cubestar",
        "far_mst",
        "nos3",
        "oersted",
        "oresat",
        "sagitta",
        "sunsat",
    ]
    assert answer["cameras"][-1]["values"]["focal_mm"] == 25.0
    assert answer["limits"]["focal_mm"] == {"min": 1.0, "max": 2000.0, "unit": "mm"}
    assert len(answer["rows"]) == 8


def test_a_quick_study_follows_the_edit(client: TestClient) -> None:
    """The result names the changed fields, and its field of view follows the focal length."""
    answer = client.post("/api/design", json={"profile": "sunsat", "focal_mm": 50, "mag_limit": 6.0}).json()
    assert answer["changed"] == ["focal_mm", "mag_limit"]
    assert not answer["full"]
    figures = {f["key"]: f["value"] for f in answer["figures"]}
    assert figures["fov_col_deg"] == pytest.approx(5.6, abs=0.05)
    assert answer["histogram"]["p_fewer_than_3"] > 0.3


@pytest.mark.parametrize(
    ("body", "status", "words"),
    [
        ({"profile": "hubble"}, 404, "Unknown instrument"),
        ({"focal_mm": 0}, 400, "focal_mm is out of range"),
        ({"focal_mm": "long"}, 422, "focal_mm"),
        ({"colour": 1}, 422, "colour"),
        ({"sky": "orbit", "pointing": "inertial"}, 400, "does not follow an orbit"),
        ({"sky": "orbit", "raan_deg": [20.0, 10.0]}, 400, "Right ascension"),
    ],
)
@pytest.mark.parametrize("path", ["/api/design", "/api/design/run"])
def test_impossible_cameras_are_rejected_at_once(
    client: TestClient, path: str, body: dict[str, Any], status: int, words: str
) -> None:
    """Both routes reject the same input before anything is queued."""
    answer = client.post(path, json=body)
    assert answer.status_code == status
    assert words in answer.json()["message"]


def test_the_full_count_is_a_job_that_can_be_cancelled(client: TestClient) -> None:
    """The full count runs as a job, which ends when it is cancelled."""
    job = client.post("/api/design/run", json={"profile": "sunsat"}).json()
    assert job["kind"] == "design"
    client.post(f"/api/jobs/{job['id']}/cancel")
    for _ in range(400):
        state = client.get(f"/api/jobs/{job['id']}").json()["state"]
        if state not in ("queued", "running"):
            break
        time.sleep(0.05)
    assert state == "cancelled"


def test_the_page_starts_with_the_camera_of_the_configured_instrument(client):
    """The server names the camera of the configured instrument; the page has no built-in default."""
    answer = client.get("/api/design/cameras").json()
    assert answer["unit"] == "cubestar"
    assert answer["unit"] in [camera["name"] for camera in answer["cameras"]]


def test_the_performance_sheet_of_a_design_can_be_read_and_exported(client: TestClient) -> None:
    """The sheet follows the edited camera, and its files have the content of the sheet. Text that is not a request is
    rejected."""
    request = {"profile": "sunsat", "focal_mm": 50}
    sheet = client.post("/api/design/sheet", json=request).json()
    assert (sheet["source"], "focal_mm 50" in sheet["subject"]) == ("design", True)
    query = {"question": json.dumps(request), "kind": "json"}
    assert client.get("/api/design/sheet/export", params=query).json() == sheet
    assert client.get("/api/design/sheet/export", params=query | {"kind": "pdf"}).content.startswith(b"%PDF")
    for text in ("", "[1]", '{"focal_mm": "long"}', '{"profile": "hubble"}', "[" * 3000):
        reply = client.get("/api/design/sheet/export", params={"question": text})
        assert reply.status_code in (400, 404), reply.text

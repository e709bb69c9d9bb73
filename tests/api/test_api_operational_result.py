"""The operational ground result of a frame is that of the configured chain and the frame's camera, independent of other
runs.
"""

from __future__ import annotations

import io
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient
from PIL import Image

from gss.catalogue_tools.sources.hipparcos import load_stars, propagate
from gss.domain.frames import cam_from_icrs
from gss.instruments.registry import shipped_camera
from gss.pipeline.render import render
from gss.settings import Settings
from gss.wiring.build import build
from gss.wiring.services import Services

CHAIN = "oersted"
PHOTOGRAPH = 4
"""Id of the last frame, which is imported without a camera."""


def rendered(seed: int) -> bytes:
    """Return a PNG of stars as the cubestar camera images them."""
    profile, rng = shipped_camera("cubestar"), np.random.default_rng(seed)
    stars = propagate(load_stars(profile.sensor.faint_limit_mag + 0.5), 2026.5)
    attitude = cam_from_icrs(rng.uniform(0, 6.28), np.arcsin(rng.uniform(-1, 1)), rng.uniform(0, 6.28))
    out = io.BytesIO()
    Image.fromarray(render(stars, profile.camera, profile.sensor, attitude, 0.25, rng).pixels).save(out, "PNG")
    return out.getvalue()


def wait_until(ready: Callable[[], bool]) -> None:
    """Wait until ``ready()`` is true."""
    for _ in range(1200):
        if ready():
            return
        time.sleep(0.1)
    pytest.fail("nothing happened")


@pytest.fixture(scope="module")
def services(tmp_path_factory: pytest.TempPathFactory) -> Services:
    """A server on an empty store."""
    return build(Settings(data=tmp_path_factory.mktemp("operational")))


@pytest.fixture(scope="module")
def client(services: Services, client_of: Callable[..., TestClient]) -> Iterator[TestClient]:
    """Client of a server that has solved three frames of a known camera and one frame of an unknown camera."""
    with client_of(services) as client:
        for k in range(1, PHOTOGRAPH + 1):
            data = {} if k == PHOTOGRAPH else {"profile": "cubestar"}
            answer = client.post("/api/frames/import", files={"file": (f"{k}.png", rendered(20 + k))}, data=data)
            assert answer.status_code == 201, answer.text
        wait_until(lambda: all(f["outcome"] for f in client.get("/api/frames").json()["frames"]))
        yield client


def ground_results(client: TestClient) -> dict[int, dict[str, Any]]:
    """Return the ground result of each frame in the list, the frame's page and its FITS file."""
    shown = {}
    for row in client.get("/api/frames").json()["frames"]:
        detail = client.get(f"/api/frames/{row['id']}").json()
        names = ("outcome", "chain", "matched", "centroids", "attitude")
        fits = client.get(f"/api/frames/{row['id']}/file.fits").content
        shown[row["id"]] = {
            "list": {name: row[name] for name in names},
            "detail": {name: detail[name] for name in names},
            "ground": detail["ground"],
            "fits": fits,
        }
    return shown


def wait_for_job(client: TestClient, job: Any) -> None:
    """Wait for the job and check that it completed."""
    assert job.status_code == 201, job.text
    path = f"/api/jobs/{job.json()['id']}"
    wait_until(lambda: client.get(path).json()["finished"] is not None)
    assert client.get(path).json()["state"] == "done", client.get(path).json()


def test_a_campaign_with_another_chain_keeps_the_ground_result(client: TestClient) -> None:
    """List, detail, filters and export keep the result of the configured chain. The campaign's result is stored
    separately.
    """
    before = ground_results(client)
    assert {v["list"]["outcome"] for v in before.values()} == {"solved"}
    wait_for_job(client, client.post("/api/campaigns/reprocess", json={"chain": CHAIN}))
    assert ground_results(client) == before
    assert client.get("/api/frames?outcome=solved").json()["total"] == PHOTOGRAPH
    for frame_id in before:
        campaign_results = [s for s in client.get(f"/api/frames/{frame_id}").json()["solutions"] if s["chain"] == CHAIN]
        assert [s["operational"] for s in campaign_results] == [False]


def test_a_manual_run_keeps_the_ground_result(client: TestClient) -> None:
    """Results of another chain, another camera or a repeated run do not replace the operational result."""
    before = ground_results(client)
    for body in ({"chain": "cubestar"}, {"fov_deg": 30.0}, {"blind": True}, {}):
        assert client.post("/api/frames/1/solve", json=body).status_code == 201
    wait_for_job(client, client.post("/api/campaigns/reprocess", json={"chain": "reference", "again": True}))
    assert ground_results(client) == before


def test_the_ground_result_names_chain_and_camera(client: TestClient) -> None:
    """The list names chain and camera of each result and marks a frame of an unknown camera as solved blind."""
    shown = {row["id"]: (row["chain"], row["camera_name"]) for row in client.get("/api/frames").json()["frames"]}
    assert shown == dict.fromkeys(range(1, PHOTOGRAPH), ("reference", "cubestar")) | {
        PHOTOGRAPH: ("reference", "blind")
    }
    assert client.get("/api/frames/1").json()["ground"]["camera_name"] == "cubestar"


def test_an_engineer_selects_another_result(client: TestClient, services: Services, client_of: Any) -> None:
    """A selection changes the result of one frame, is audited and can be undone. Operators may not select."""
    before = ground_results(client)
    detail = client.get("/api/frames/2").json()
    other = next(s for s in detail["solutions"] if s["chain"] == CHAIN)
    path, body = "/api/frames/2/operational", {"solution_id": other["id"]}
    assert client_of(services, "olga", "operator").put(path, json=body).status_code == 403
    assert ground_results(client) == before
    assert client_of(services, "emil", "engineer").put(path, json=body).json()["chain"] == CHAIN
    after = ground_results(client)
    assert {k for k in after if after[k] != before[k]} == {2}
    assert [s["id"] for s in client.get("/api/frames/2").json()["solutions"] if s["operational"]] == [other["id"]]
    rows = client.get("/api/audit?limit=20").json()
    assert any(row["who"] == "emil" and str(other["id"]) in row["detail"] for row in rows), rows
    first = before[2]["ground"]["id"]
    assert client.put(path, json={"solution_id": first}).status_code == 200
    assert ground_results(client) == before


def test_an_invalid_selection_is_rejected(client: TestClient) -> None:
    """Results of another frame and results that do not exist are rejected."""
    other = client.get("/api/frames/3").json()["ground"]["id"]
    reply = client.put("/api/frames/2/operational", json={"solution_id": other})
    assert (reply.status_code, "frame 3" in reply.json()["got"]) == (400, True), reply.text
    assert client.put("/api/frames/2/operational", json={"solution_id": 999999}).status_code == 404


def test_a_frame_without_a_result_gets_it_from_a_campaign(client: TestClient, services: Services) -> None:
    """A run of the configured chain with the frame's camera sets a missing ground result. Other runs do not."""
    row = services.frames.frames.get(1)
    skipped = {"source": "import", "name": "skipped", "profile": "cubestar"}
    facts = {name: getattr(row, name) for name in ("bits", "exposure_s", "taken")}
    frame, _ = services.frames.frames._add(services.frames.frames.pixels(row), **skipped, **facts)
    wait_for_job(client, client.post("/api/campaigns/reprocess", json={"chain": CHAIN, "frame_ids": [frame.id]}))
    assert client.post(f"/api/frames/{frame.id}/solve", json={"blind": True}).status_code == 201
    assert client.get(f"/api/frames/{frame.id}").json()["ground"] is None
    assert client.get("/api/frames?outcome=unsolved").json()["total"] == 1
    again = {"chain": "reference", "frame_ids": [frame.id], "again": True}
    wait_for_job(client, client.post("/api/campaigns/reprocess", json=again))
    ground_result = client.get(f"/api/frames/{frame.id}").json()["ground"]
    assert (ground_result["chain"], ground_result["camera_name"], ground_result["outcome"]) == (
        "reference",
        "cubestar",
        "solved",
    )

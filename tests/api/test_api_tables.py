"""Tables for the sensor over HTTP, without a device."""

from __future__ import annotations

import time
from typing import Any

import pytest
from fastapi.testclient import TestClient

from gss.catalogue_tools.formats.triplet_table import decode_triplets
from gss.device.tables import decode_table


def build_catalogue(client: TestClient, **request: Any) -> int:
    job = client.post("/api/catalogues", json={"profile": "oersted", "format": "cubestar", **request}).json()
    for _ in range(400):
        row = next(j for j in client.get("/api/jobs").json() if j["id"] == job["id"])
        if row["state"] in ("done", "failed"):
            assert row["state"] == "done", row["text"]
            return int(row["result"]["catalogue_id"])
        time.sleep(0.05)
    pytest.fail("the catalogue was not built")


@pytest.mark.parametrize("kind", ["calibration", "parameters"])
@pytest.mark.parametrize("profile", ["cubestar", "sunsat", "far_mst", "oersted", "aim"])
def test_every_camera_s_values_survive_the_table_format(client: TestClient, kind: str, profile: str) -> None:
    """The default values of each camera are encoded to bytes and decoded without a change."""
    defaults = client.get("/api/tables/defaults", params={"kind": kind, "profile": profile}).json()["content"]
    reply = client.post("/api/tables", json={"kind": kind, "name": "own", "profile": profile})
    assert reply.status_code == 201, reply.text
    data = client.get(f"/api/tables/{reply.json()['id']}/file.bin").content
    name, values = decode_table(kind, data)
    assert name == profile
    assert values == defaults == reply.json()["content"]
    assert reply.json()["size"] == len(data)


def test_triplets_are_built_of_a_stored_catalogue(client: TestClient) -> None:
    """A triplet table refers to the stars of its catalogue. Catalogues of other cameras and invalid content are
    rejected.
    """
    catalogue_id = build_catalogue(client, faint_mag=5.5, pair_max_deg=5.0)
    body = {
        "kind": "triplets",
        "name": "t",
        "profile": "oersted",
        "content": {"catalogue_id": catalogue_id, "limit_mag": 4.5},
    }
    reply = client.post("/api/tables", json=body)
    assert reply.status_code == 201, reply.text
    table = decode_triplets(client.get(f"/api/tables/{reply.json()['id']}/file.bin").content)
    assert reply.json()["content"]["references"] == len(table) > 100
    assert table.limit_mag == pytest.approx(4.5)
    figures = reply.json()["content"]
    assert figures["list_ends_mag"] == pytest.approx(5.5, abs=0.05)
    assert figures["complete_to_mag"] == pytest.approx(4.812, abs=1e-3)
    assert table.stars == client.get(f"/api/catalogues/{catalogue_id}").json()["stars"]
    rejected = client.post("/api/tables", json=body | {"profile": "sunsat"})
    assert (rejected.status_code, rejected.json()["got"]) == (400, "oersted")
    for content in ({"catalogue_id": catalogue_id, "limit_mag": 99}, {"catalogue_id": catalogue_id, "colour": 1}, {}):
        assert client.post("/api/tables", json=body | {"content": content}).status_code == 400
    assert client.post("/api/tables", json=body | {"content": {"catalogue_id": 9999}}).status_code == 404


def test_without_a_device_sending_is_rejected_with_the_reason(client: TestClient) -> None:
    """Uploads and downloads without a link are a conflict. Unknown tables and transfers are a 404."""
    stored = client.post("/api/tables", json={"kind": "calibration", "profile": "cubestar"}).json()
    assert stored["name"] == "cubestar calibration"
    assert client.get("/api/tables/on-board").json() == []
    assert client.get("/api/tables", params={"kind": "calibration", "limit": 1}).json()[0]["id"] == stored["id"]
    for path, body in (
        (f"/api/tables/{stored['id']}/upload", {"bank": "A"}),
        ("/api/transfers/download", {"kind": "frame", "slot": 0}),
        ("/api/transfers/download", {"kind": "parameters", "bank": "factory"}),
    ):
        assert client.post(path, json=body).status_code == 409
    assert client.post("/api/transfers/download", json={"kind": "frame"}).status_code == 400
    assert client.post("/api/transfers/download", json={"kind": "video", "slot": 0}).status_code == 422
    assert client.post("/api/tables/99999/upload", json={"bank": "A"}).status_code == 404
    assert client.post("/api/transfers/99999/resume").status_code == 404

"""Every commanding route checks the authority; further checks of users, times and types of values."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from fastapi.testclient import TestClient


@pytest.fixture(scope="module")
def headers(client: TestClient, signed_in: Callable[..., dict[str, str]]) -> dict[str, dict[str, str]]:
    """Request headers of the operators alice, bob and carol."""
    return {name: signed_in(client.app.state.services, "operator", name) for name in ("alice", "bob", "carol")}


@pytest.mark.parametrize(
    ("path", "body"),
    [
        ("/api/link/close", None),
        ("/api/link/open", {"url": "socket://127.0.0.1:9"}),
        ("/api/link/acknowledge-dictionary", None),
        ("/api/transfers/download", {"kind": "frame", "slot": 0}),
        ("/api/frames/download", {"kind": "frame", "slot": 0}),
        ("/api/transfers/1/resume", None),
        ("/api/commands", {"name": "GET_STATUS", "arguments": {}, "confirm": ""}),
    ],
)
def test_no_other_user_commands_through_another_route(
    client: TestClient, headers: dict[str, dict[str, str]], path: str, body: dict[str, Any] | None
) -> None:
    """While alice has the command authority, every route rejects requests of bob."""
    assert client.post("/api/authority/take", headers=headers["alice"]).status_code in (200, 409)
    answer = client.post(path, json=body, headers=headers["bob"])
    assert answer.status_code == 409, answer.text
    assert "alice" in answer.text


def test_a_limit_change_is_recorded_with_its_user(client: TestClient, headers: dict[str, dict[str, str]]) -> None:
    """The changed limit names the user who changed it, not the server."""
    limit = {
        "watch": [-10, 40],
        "warning": [None, None],
        "critical": [None, None],
        "persistence": None,
        "note": "bench",
    }
    key = "housekeeping.sensor_temperature_c"
    changed = client.put(f"/api/telemetry/limits/{key}", json=limit, headers=headers["carol"])
    assert changed.status_code == 200, changed.text
    assert changed.json()["changed_by"] == "carol"


@pytest.mark.parametrize("path", ["/api/commands", "/api/commands.csv", "/api/telemetry/packets"])
def test_a_time_beyond_the_calendar_is_rejected(client: TestClient, path: str) -> None:
    """A time beyond the calendar is a 422, not a server error and not an empty file."""
    assert client.get(path, params={"end": "9999-12-31T23:59:59-14:00"}).status_code == 422


def test_default_parameters_are_accepted_unchanged(client: TestClient) -> None:
    """The default values of a parameter set are accepted without changes."""
    defaults = client.get("/api/tables/defaults", params={"kind": "parameters", "profile": "cubestar"}).json()
    body = {"kind": "parameters", "name": "as it is", "profile": "cubestar", "content": defaults["content"]}
    answer = client.post("/api/tables", json=body)
    assert answer.status_code == 201, answer.text


def test_a_number_as_text_is_rejected(client: TestClient) -> None:
    """A focal length given as text is rejected with an error that names the field."""
    body = {"kind": "calibration", "name": "x", "profile": "cubestar", "content": {"focal_col_px": "12"}}
    answer = client.post("/api/tables", json=body)
    assert answer.status_code in (400, 422)
    assert "focal_col_px" in answer.text

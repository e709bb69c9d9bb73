"""The link over a serial device server (RFC 2217), opened through the API."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest
from fastapi.testclient import TestClient

from gss.api.app import create_app
from gss.settings import Settings
from gss.wiring.build import build
from tests.contract.rfc2217_line import Rfc2217Server

if TYPE_CHECKING:
    from conftest import Contact, Simulator


@pytest.fixture
def server(simulator: Callable[..., Simulator], tmp_path: Path) -> Iterator[Rfc2217Server]:
    """An RFC 2217 server with a simulated sensor behind it."""
    options = ("--profile", "cubestar", "--tcp", "0", "--baud", "0", "--state-dir", str(tmp_path / "sensor"))
    (tmp_path / "sensor").mkdir()
    running = Rfc2217Server(simulator(*options).url)
    yield running
    running.stop()


def until(client: TestClient, done: Callable[[Any], bool]) -> Any:
    """Return the link's state when the condition is true. Fails after a time limit."""
    limit_s = time.monotonic() + 30
    while not done(state := client.get("/api/link").json()):
        assert time.monotonic() < limit_s, state
        time.sleep(0.05)
    return state


def test_a_link_over_rfc2217_opens_through_the_api_and_the_sensor_answers(
    server: Rfc2217Server, tmp_path: Path, signed_in: Callable[..., dict[str, str]]
) -> None:
    """POST /api/link/open succeeds, HELLO is answered, a command completes, and the line closes."""
    services = build(Settings(data=tmp_path / "data", password_memory_kib=8, password_passes=1))
    with TestClient(create_app(services), base_url="http://localhost", headers=signed_in(services)) as client:
        reply = client.post("/api/link/open", json={"url": server.url})
        assert reply.status_code == 200, reply.text
        until(client, lambda state: state["connected"] and state["dictionary_match"])
        assert server.baud == 115_200
        row = client.post("/api/commands", json={"name": "GET_STATUS", "arguments": {}, "confirm": ""}).json()
        until(client, lambda _state: client.get(f"/api/commands/{row['id']}").json()["result"] == "completed")
        assert client.post("/api/link/close").status_code == 200
        until(client, lambda state: not state["connected"])


def test_bytes_that_telnet_escapes_arrive_unchanged(server: Rfc2217Server, contact: Callable[[str], Contact]) -> None:
    """A frame that contains every byte value, also 255, is downloaded without a change."""
    device = contact(server.url)
    assert device.do("TAKE_IMAGE").reason == ""
    update = device.finish(device.host.transfers.start_download("image", 0))
    assert update.state == "verified"

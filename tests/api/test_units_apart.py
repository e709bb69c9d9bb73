"""Separation of units: a request below the address of a unit reaches only the process of this unit, or no process."""

from __future__ import annotations

import asyncio
import json
import tempfile
import threading
import time
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import uvicorn
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from starlette.types import Message, Receive, Scope, Send

from gss.api.units.fleet import Fleet, process_name
from gss.api.units.unit_gateway import UnitGateway
from gss.api.units.unit_spec import UnitSpec
from gss.api.workers.supervisor import Supervisor, no_obstacle
from gss.domain.errors import Conflict

NAMES = ("A", "B", "FM-1")


@dataclass
class UnitProcess:
    """Substitute for the process of a unit: stores the received bodies and returns all of them."""

    name: str
    bodies: list[str] = field(default_factory=list)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        body = b""
        while (message := await receive())["type"] == "http.request":
            body += message.get("body", b"")
            if not message.get("more_body"):
                break
        self.bodies.append(body.decode())
        await send({"type": "http.response.start", "status": 200, "headers": [(b"content-type", b"application/json")]})
        await send({"type": "http.response.body", "body": json.dumps([self.name, self.bodies]).encode()})


@pytest.fixture(scope="module")
def processes() -> Iterator[tuple[dict[str, UnitProcess], Fleet]]:
    """One application per unit on a Unix socket, and the fleet that forwards to them."""
    with tempfile.TemporaryDirectory() as folder:
        apps = {name: UnitProcess(name) for name in NAMES}
        paths = {name: Path(folder) / f"{name}.socket" for name in NAMES}
        servers = [
            uvicorn.Server(uvicorn.Config(apps[n], uds=str(paths[n]), lifespan="off", log_level="critical"))
            for n in NAMES
        ]
        threads = [threading.Thread(target=server.run, daemon=True) for server in servers]
        for thread in threads:
            thread.start()
        while not all(server.started for server in servers):
            time.sleep(0.01)
        specs = tuple(UnitSpec(name, "cubestar", "simulator") for name in NAMES)
        yield (
            apps,
            Fleet(
                specs, paths, Supervisor({}, lambda _: None, no_obstacle), lambda name, samples: None, time.monotonic
            ),
        )
        for server in servers:
            server.should_exit = True
        for thread in threads:
            thread.join(10)


def test_a_process_without_a_report_has_the_time_since_its_start() -> None:
    """Before its start, a process has no age. A process that hangs before its first report has the time since its
    start."""
    spec, path = UnitSpec("A", "cubestar", "simulator"), Path("/nonexistent/A.socket")
    supervisor = Supervisor({process_name(spec): partial(time.sleep, 60)}, lambda _: None, no_obstacle)
    now_s = [0.0]
    fleet = Fleet((spec,), {"A": path}, supervisor, lambda name, samples: None, lambda: time.monotonic() + now_s[0])
    assert fleet.states()[0].process_age_s is None
    supervisor.start()
    try:
        while (age_s := fleet.states()[0].process_age_s) is None:
            time.sleep(0.01)
        now_s[0] = 300.0
        (state,) = fleet.states()
        assert state.link is None
        assert 300.0 <= (state.process_age_s or 0) < 360.0 + age_s
    finally:
        supervisor.stop()


def test_a_process_with_an_obstacle_starts_when_the_obstacle_is_removed() -> None:
    """The process is not started before, the obstacle is its reason in the fleet, and one event reports it."""
    spec, checks, events = UnitSpec("A", "cubestar", "simulator"), threading.Semaphore(0), list[str]()
    obstacles = {process_name(spec): "one of the drivers"}

    def obstacle(name: str) -> str:
        checks.release()
        return obstacles[name]

    supervisor = Supervisor({process_name(spec): partial(time.sleep, 60)}, events.append, obstacle)
    fleet = Fleet((spec,), {"A": Path("/nonexistent/A.socket")}, supervisor, lambda *_: None, time.monotonic)
    supervisor.start()
    try:
        for _ in range(3):
            assert checks.acquire(timeout=60)
        (state,) = fleet.states()
        assert (state.reason, state.process.pid, state.process.restarts) == ("one of the drivers", None, 0)
        with pytest.raises(Conflict):
            fleet.restart("A", "admin")
        obstacles[process_name(spec)] = ""
        end_s = time.monotonic() + 60
        while not fleet.states()[0].process.pid and time.monotonic() < end_s:
            time.sleep(0.01)
        (state,) = fleet.states()
        assert (state.reason, bool(state.process.pid), state.process.restarts) == ("", True, 0)
    finally:
        supervisor.stop()
    assert events == ["unit A cannot start: one of the drivers"]


async def front_process(scope: Scope, receive: Receive, send: Send) -> None:
    """Substitute for the front process with accounts and pages."""
    await send({"type": "http.response.start", "status": 404, "headers": []})
    await send({"type": "http.response.body", "body": b'["front", []]'})


async def send_request(gateway: UnitGateway, path: str, body: str) -> Any:
    """Send a request with its path unchanged and return status and body of the response."""
    sent: list[Message] = []
    raw = path.encode("utf-8", "surrogatepass")
    scope: Scope = {"type": "http", "method": "POST", "path": path, "raw_path": raw, "query_string": b"", "state": {}}
    scope |= {"headers": [(b"content-length", str(len(body)).encode())], "http_version": "1.1", "scheme": "http"}
    delivered = False

    async def receive() -> Message:
        nonlocal delivered
        if delivered:
            await asyncio.sleep(60)
        delivered = True
        return {"type": "http.request", "body": body.encode(), "more_body": False}

    async def send(message: Message) -> None:
        sent.append(message)

    await gateway(scope, receive, send)
    return sent[0]["status"], b"".join(m.get("body", b"") for m in sent)


inner_paths = st.sampled_from(["api/commands", "api/telemetry", "api", "live", "", "api//commands", "api/session"])
suffixes = st.sampled_from(
    ["", "../B/api/x", "%2e%2e/B/api/x", "..%2fB/api/x", "/units/B/api/x", "units/B/api/x", "\\..\\B", "?unit=B"]
)
names = st.sampled_from([*NAMES, "a", "", "..", "A%2fB", "B/../A", "C"])
requests = st.lists(st.tuples(names, inner_paths, suffixes), min_size=1, max_size=8)


@settings(deadline=None, max_examples=40, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(requests)
def test_a_request_reaches_its_own_unit_or_none(
    processes: tuple[dict[str, UnitProcess], Fleet], targets: list[tuple[str, str, str]]
) -> None:
    """A request with any path reaches its own unit or none, also during requests to other units."""
    apps, fleet = processes
    targets = [*targets, *((name, "api/commands", "") for name in NAMES)]
    gateway = UnitGateway(front_process, fleet)
    for app in apps.values():
        app.bodies.clear()

    async def all_at_once() -> list[Any]:
        calls = [
            send_request(gateway, f"/units/{name}/{path}/{trick}", f"{name} {k}")
            for k, (name, path, trick) in enumerate(targets)
        ]
        return await asyncio.gather(*calls)

    for (name, _, _), (status, content) in zip(targets, asyncio.run(all_at_once()), strict=True):
        if status == 200:
            first_part = name.split("/")[0]
            unit, bodies = json.loads(content)
            assert unit == first_part
            assert all(body.split("/")[0].split(" ")[0] == first_part for body in bodies)
    for app in apps.values():
        assert app.bodies
        assert all(body.split("/")[0].split(" ")[0] == app.name for body in app.bodies)

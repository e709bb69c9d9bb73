"""Several API worker processes beside the link process: clients see no difference, and the loss of a worker loses
nothing.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import os
import signal
import stat
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx2
import pytest

from tools.served import Served, served
from tools.stream_client import StreamLog, listen

pytestmark = pytest.mark.timeout(240)
ENDED = ("completed", "rejected", "failed", "unknown")
LOCAL = (
    "/frames",
    "/frames/{frame}",
    "/frames/{frame}/pixels?row=3&col=4",
    "/frames/{frame}/histogram",
    "/frames/{frame}/image.png",
    "/frames/{frame}/raw",
    "/solutions/{solution}",
    "/events",
    "/telemetry/cycles",
    "/telemetry/packets?limit=5&before_id=8",
    "/commands/facets",
    "/commands.csv?name=TAKE_IMAGE",
    "/catalogues/{catalogue}/manifest.json",
    "/catalogues/{catalogue}/image.bin",
    "/campaigns/chains",
    "/analyses",
    "/design/cameras",
    "/profiles",
    "/contacts",
)


class OperatorConsole:
    """HTTP client of an admin."""

    def __init__(self, server: Served) -> None:
        self.server, self.address, self.headers = server, server.address, server.headers
        self.http = httpx2.Client(base_url=f"{server.address}/api", headers=server.headers, timeout=60)

    def get(self, path: str, **query: Any) -> Any:
        reply = self.http.get(path, params=query)
        assert reply.status_code == 200, reply.text
        return reply.json()

    def wait(self, what: str, look: Callable[[], Any], seconds: float = 60.0) -> Any:
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            with contextlib.suppress(httpx2.TransportError):  # the workers take some seconds to load
                if found := look():
                    return found
            time.sleep(0.05)
        pytest.fail(f"waited {seconds:g} s for {what}")

    def complete(self, name: str, **arguments: Any) -> None:
        """Send a command until it was completed; on a crowded machine a report can come too late."""
        for _ in range(3):
            row = self.http.post("/commands", json={"name": name, "arguments": arguments, "confirm": ""}).json()
            ended = self.wait(name, lambda row=row: (c := self.get(f"/commands/{row['id']}"))["result"] in ENDED and c)
            if ended["result"] == "completed":
                return
            time.sleep(3)  # the simulated sensor loads what it needs at the first use
        pytest.fail(f"{name}: {ended['result']} {ended['detail']}")


@pytest.fixture(scope="module")
def private_folder(tmp_path_factory):
    """Folder in which the server creates its private socket."""
    return tmp_path_factory.mktemp("t")


@pytest.fixture(scope="module")
def desk(tmp_path_factory, private_folder):
    """Client of a server with two API workers and a simulated sensor that has reported its banks."""
    folder = tmp_path_factory.mktemp("server") / "data"
    options = {"TMPDIR": str(private_folder), "GSS_SIMULATOR_BAUD": "0"}
    with served(folder, "--simulator", "cubestar", "--workers", "2", **options) as server:
        desk = OperatorConsole(server)
        desk.wait("the workers at the door", lambda: server.listeners() == 1, 150)
        desk.wait("the sensor's banks", lambda: (desk.get("/link")["active_bank"] or {}).get("catalogue_id"), 150)
        yield desk
        desk.http.close()


def responses_equal(one: httpx2.Response, other: httpx2.Response) -> bool:
    """True if two responses are equal; numbers may differ in the last digit, because two processes may add the
    same numbers in another order.
    """
    if "json" not in one.headers["content-type"] or "json" not in other.headers["content-type"]:
        return one.content == other.content

    def same(a: Any, b: Any) -> bool:
        if isinstance(a, float) and isinstance(b, float):
            return math.isclose(a, b, rel_tol=1e-6, abs_tol=2e-5)
        if isinstance(a, dict) and isinstance(b, dict):
            return a.keys() == b.keys() and all(same(a[k], b[k]) for k in a)
        if isinstance(a, list) and isinstance(b, list):
            return len(a) == len(b) and all(map(same, a, b))
        return type(a) is type(b) and a == b

    return same(one.json(), other.json())


def workers_of(server: Served) -> dict[str, int]:
    """Return the process ids of the running workers by name."""
    return {name: pid for name, pid in server.processes().items() if name != "link"}


def test_the_main_job_through_workers_gives_the_responses_of_the_link_process(desk, private_folder):
    """The main job works through two workers, whose local responses equal those of the link process. Only the owner can
    open the private socket, and a request to it without a session is rejected.
    """
    console = desk
    assert len(workers_of(desk.server)) == 2
    console.complete("SET_MODE", mode="lost_in_space")
    for name in ("TAKE_IMAGE", "FIND_CENTROIDS", "MATCH_STARS", "CALCULATE_ATTITUDE"):
        console.complete(name)
    frame = console.wait(
        "comparison",
        lambda: next(
            (d for f in console.get("/frames")["frames"] if (d := console.get(f"/frames/{f['id']}"))["comparison"]),
            None,
        ),
    )
    assert frame["comparison"]["agree"]
    assert console.get(f"/frames/{frame['id']}/replay")["text"] == "equal"

    (private,) = private_folder.glob("gss-*/link")
    assert stat.S_IMODE(private.stat().st_mode) == 0o600
    assert stat.S_IMODE(private.parent.stat().st_mode) == 0o700
    ids = {
        "frame": frame["id"],
        "solution": frame["solutions"][0]["id"],
        "catalogue": console.get("/catalogues")[0]["id"],
    }
    with httpx2.Client(transport=httpx2.HTTPTransport(uds=str(private)), base_url="http://localhost/api") as link:
        for template in LOCAL:
            path = template.format(**ids)
            from_worker = console.http.get(path)
            from_link = link.get(path, headers=console.headers)
            assert from_worker.status_code == 200, (path, from_worker.text)
            if path not in ("/contacts", "/events"):  # these change between two requests
                assert responses_equal(from_worker, from_link), path
        assert link.get("/link").status_code == 401
        assert link.get("/frames").status_code == 401
    assert console.http.get("/frames/999999").status_code == 404
    assert console.http.get("/nothing").status_code == 404
    big = b"\0" * (3 << 20)
    refused = console.http.post("/frames/import", files={"file": ("x.png", big)})
    assert (refused.status_code, "x.png" in refused.text or refused.json()["message"] != "") == (400, True)


def test_a_session_is_shared_by_all_workers(desk):
    """Failed sign-ins of all workers count together; signing out applies to all of them; no client can set its own
    address.
    """
    console = desk
    spoofed = {"X-GSS": "1", "X-GSS-Peer": "10.9.8.7 1 http"}
    codes = []
    for _ in range(12):  # a new connection each: whichever worker is first takes it
        reply = httpx2.post(
            f"{console.address}/api/session", json={"name": "eve", "password": "a wrong one"}, headers=spoofed
        )
        codes.append(reply.status_code)
    assert codes[0] == 401
    assert 429 in codes[5:]
    assert all(row["address"] != "10.9.8.7" for row in console.get("/audit"))
    cookie = {"Cookie": f"gss_session={console.server.sign_in()}"}
    csrf = httpx2.get(f"{console.address}/api/session", headers=cookie).json()["csrf"]
    pages = [f"{console.address}/api/{what}" for what in ("link", "frames") * 3]
    assert {httpx2.get(page, headers=cookie).status_code for page in pages} == {200}
    assert httpx2.delete(f"{console.address}/api/session", headers=cookie | {"X-GSS": csrf}).status_code == 204
    deadline = time.monotonic() + 10
    while time.monotonic() < deadline:
        answers = {httpx2.get(page, headers=cookie).status_code for page in pages}
        if answers == {401}:
            return
    pytest.fail(f"still answered after signing out: {answers}")


def test_a_killed_worker_loses_nothing(desk):
    """After both workers are killed, acknowledged commands are stored once, streams resume without a missing
    event, and new workers start. ABORT works without workers. Workers end with the link process.
    """
    console = desk
    host, port = console.address.removeprefix("http://").split(":")
    logs = [StreamLog() for _ in range(8)]
    before, until_s, finished = workers_of(desk.server), time.monotonic() + 150, threading.Event()

    async def follow_streams() -> None:
        listening = [asyncio.create_task(listen(host, int(port), console.headers, h, until_s)) for h in logs]
        await asyncio.to_thread(finished.wait)
        for task in listening:
            task.cancel()
        await asyncio.gather(*listening, return_exceptions=True)

    listeners = threading.Thread(target=lambda: asyncio.run(follow_streams()))
    listeners.start()
    acknowledged, broken, killed = [], 0, 0
    while len(acknowledged) < 30 and time.monotonic() < until_s - 60:
        if len(acknowledged) >= 10 * (killed + 1) and killed < 2:  # one after the other: one of them has the streams
            killed += 1
            os.kill(before[f"worker {killed}"], signal.SIGKILL)
        try:
            body = {"name": "GET_STATUS", "arguments": {}, "confirm": ""}
            reply = httpx2.post(f"{console.address}/api/commands", json=body, headers=console.headers, timeout=20)
            acknowledged += [reply.json()["id"]] if reply.status_code == 201 else []
            broken += reply.status_code != 201
        except httpx2.HTTPError:
            broken += 1
        time.sleep(0.05)

    def new_workers() -> bool:
        now = set(workers_of(desk.server).values())
        return len(now) == 2 and not now & set(before.values())

    def newest() -> int:
        return int(console.get("/events", limit=1000)[-1]["seq"])

    try:
        console.wait("another worker", new_workers, 30)
        console.wait("every stream to have every event", lambda: {h.seq for h in logs} == {newest()})
    finally:
        finished.set()
        listeners.join()
    rows = console.get("/commands", limit=1000, name="GET_STATUS")
    stored = [row["id"] for row in rows if row["user"] != "gss"]
    assert killed == 2
    assert len(acknowledged) > 20
    assert set(acknowledged) <= set(stored)
    assert len(stored) == len(set(stored)) <= len(acknowledged) + broken
    assert any(h.ended for h in logs), "no stream was on the worker that was killed"
    assert {(h.jumps, h.dropped) for h in logs} == {(0, 0)}
    assert any("API worker" in e["text"] and "signal 9" in e["text"] for e in console.get("/events", limit=1000))

    replacements = abort_gets_through_while_no_worker_is_alive(console)
    desk.server.process.kill()
    deadline = time.monotonic() + 60
    while any(_alive(pid) for pid in replacements) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not [pid for pid in replacements if _alive(pid)]


def abort_gets_through_while_no_worker_is_alive(console: OperatorConsole) -> set[int]:
    """Kill both workers and suspend their replacements; the link process must then answer on the public port.

    Returns the process ids of the replacements.
    """
    before = set(workers_of(console.server).values())
    for pid in before:
        os.kill(pid, signal.SIGKILL)

    def next_two() -> set[int]:
        now = set(workers_of(console.server).values()) - before
        return now if len(now) == 2 else set()

    suspended: set[int] = console.wait("their replacements", next_two, 60)
    for pid in suspended:
        os.kill(pid, signal.SIGSTOP)
    try:
        abort = httpx2.post(f"{console.address}/api/commands/abort", headers=console.headers, timeout=60)
        anonymous = httpx2.get(f"{console.address}/api/link", timeout=60)
        assert (abort.status_code, anonymous.status_code) == (201, 401)
        assert console.server.listeners() == 2
    finally:
        for pid in suspended:
            os.kill(pid, signal.SIGCONT)
    return suspended


def _alive(pid: int) -> bool:
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"
    except OSError:
        return False

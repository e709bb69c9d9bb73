"""After a crash, a lost line or a second server nothing is lost and nothing is sent twice."""

from __future__ import annotations

import subprocess
import sys

import pytest

pytestmark = pytest.mark.timeout(240)


def online(console):
    """Wait until the sensor has answered on this server."""
    return console.wait("the sensor", lambda: (console.get("/link")["active_bank"] or {}).get("catalogue_id"), 60)


def test_a_killed_server_loses_nothing_acknowledged(serve, simulator):
    """After kill -9 frames and commands are stored, the link reopens automatically, and request ids continue."""
    first = serve("--device", simulator)
    online(first.console)
    taken = first.console.command("TAKE_IMAGE")
    frame = first.console.wait("the frame", lambda: first.console.get("/frames")["frames"])[0]
    first.kill()

    second = serve("--device", simulator)
    online(second.console)
    assert second.console.get(f"/frames/{frame['id']}")["sha256"] == frame["sha256"]
    stored = second.console.get(f"/commands/{taken['id']}")
    assert (stored["result"], stored["request_id"]) == ("completed", taken["request_id"])
    again = second.console.command("TAKE_IMAGE")
    assert again["result"] == "completed"
    assert again["request_id"] > taken["request_id"]
    assert [c["ended"] is None for c in second.console.get("/contacts")] == [True, False]


def test_command_in_flight_at_a_crash_comes_back_unknown_and_is_not_sent_again(serve, simulator):
    """A command in progress at a crash is not repeated. Its result is unknown or follows from a late report."""
    first = serve("--device", simulator)
    online(first.console)
    before = first.console.get("/commands", limit=1)[0]["id"]
    first.console.post("/commands", {"name": "TAKE_IMAGE", "arguments": {"exposure_ms": 1000}})
    first.kill()

    second = serve("--device", simulator)
    online(second.console)
    row = second.console.get(f"/commands/{before + 1}")
    assert row["name"] == "TAKE_IMAGE"
    if row["result"] == "unknown":
        assert "restarted" in row["detail"]
        settled = second.console.post(f"/commands/{row['id']}/resolve", {"note": "frame seen on board"}, status=200)
        assert settled["result"] == "resolved"
    else:  # the report arrived late, at the new server, which identified it by its id
        assert row["result"] == "completed"
    assert [c["name"] for c in second.console.get("/commands", limit=20)].count("TAKE_IMAGE") == 1


def test_a_second_server_on_one_sensor_port_is_rejected(serve, tmp_path):
    """A second process cannot open the port, and a failed change of the line keeps the existing one."""
    first = serve("--simulator", "cubestar")
    url = first.console.wait("the port", lambda: first.console.get("/link")["url"])
    online(first.console)
    reply = first.console.http.post("/link/open", json={"url": "/dev/does-not-exist"})
    assert reply.status_code in (400, 404, 503)
    assert first.console.get("/link")["url"] == url

    command = [sys.executable, "-c", f"from gss.device.transport import open_stream; open_stream({url!r})"]
    other = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert other.returncode != 0
    assert "Conflict" in other.stderr
    assert first.console.command("GET_STATUS")["result"] == "completed"


def test_line_that_vanishes_and_returns_is_opened_again(serve, simulator):
    """Closing the line ends a contact, opening it begins another, and the sensor answers again."""
    server = serve("--device", simulator)
    online(server.console)
    server.console.post("/link/close", status=200)
    server.console.wait("the line to close", lambda: not server.console.get("/link")["connected"])
    refused = server.console.http.post("/commands", json={"name": "GET_STATUS"})
    assert (refused.status_code, refused.json()["message"]) == (409, "The line is down.")
    server.console.post("/link/open", {"url": simulator}, status=200)
    server.console.wait(
        "the sensor again",
        lambda: server.console.get("/link")["dictionary_match"] and server.console.get("/link")["connected"],
    )
    assert server.console.command("GET_STATUS")["result"] == "completed"
    assert len(server.console.get("/contacts")) == 2


def test_server_refuses_to_listen_beyond_this_machine():
    """Without TLS the server listens only on loopback addresses."""
    command = [sys.executable, "-m", "gss", "serve", "--host", "192.0.2.1", "--port", "0"]
    other = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert other.returncode == 2
    assert "loopback" in other.stderr


def test_one_data_folder_has_one_server(serve, tmp_path):
    """The second server is rejected with a message and does not change the data of the first."""
    first = serve("--simulator", "cubestar")
    online(first.console)
    command = [sys.executable, "-m", "gss", "serve", "--port", "0", "--data", str(first.folder)]
    other = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert (other.returncode, "Another GSS server" in other.stderr) == (2, True)
    assert first.console.get("/contacts")[0]["ended"] is None


def test_stopping_with_an_open_stream_is_quick_and_quiet(serve):
    """With an open stream, SIGINT ends the server with exit code 0 and without a traceback."""
    import threading
    from pathlib import Path

    import httpx2

    server = serve("--simulator", "cubestar")
    online(server.console)
    opened = threading.Event()

    def listen() -> None:
        with httpx2.stream(
            "GET", f"{server.console.address}/api/stream", headers=server.console.headers, timeout=30
        ) as reply:
            for line in reply.iter_lines():
                if line.startswith("event: link"):
                    opened.set()

    reader = threading.Thread(target=listen, daemon=True)
    reader.start()
    assert opened.wait(20)
    server.stop()
    reader.join(10)
    assert server.process.returncode == 0
    assert "Traceback" not in Path(server.log.name).read_text()


def test_a_locked_database_blocks_only_commands_until_it_is_unlocked(serve, simulator):
    """While the store cannot be written a command is rejected and not sent; afterwards the link works again
    automatically.
    """
    import sqlite3
    import time

    console = (server := serve("--device", simulator)).console
    online(console)
    console.command("SET_EXPOSURE", exposure_ms=111)
    other = sqlite3.connect(server.folder / "gss.db", isolation_level=None)
    other.execute("BEGIN IMMEDIATE")
    refused = console.http.post("/commands", json={"name": "SET_EXPOSURE", "arguments": {"exposure_ms": 222}})
    assert refused.status_code == 503
    assert "database" in refused.json()["message"]
    time.sleep(4)  # long enough for the link's own writing to fail as well
    other.execute("ROLLBACK")
    other.close()

    def again():
        reply = console.http.post("/commands", json={"name": "GET_STATUS"})
        return reply.json() if reply.status_code == 201 else None

    row = console.wait("the line to work again", again)
    console.wait("its report", lambda: console.get(f"/commands/{row['id']}")["result"] == "completed")
    sent = [c["arguments"] for c in console.get("/commands", limit=50) if c["name"] == "SET_EXPOSURE"]
    assert sent == [{"exposure_ms": 111}]
    latest = console.get("/telemetry/latest")["values"]
    values = {v["name"]: v["value"] for v in latest if v["packet"] == "housekeeping"}
    assert values["exposure_ms"] == 111

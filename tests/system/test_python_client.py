"""The Python client against a real server and a simulated sensor, also while the server restarts."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest

from gss.client import Client, ClientError, CommandFailed, NotAllowed, Packet, ProcedureFailed, ServerAway, TimedOut

pytestmark = pytest.mark.timeout(240)
PROCEDURE = """# Look at the sensor

## status: Ask for the status

```command
GET_STATUS
```

## free: May the cycle be stopped?

```question
Is the sensor free?
yes: next
no: end
```

## second: A second person looks

```hold
Everything is in order.
```
"""


@pytest.fixture
def new_token(serve):
    """Function that creates an API token on a running server and returns its key."""

    def create(console, role: str = "operator") -> str:
        return console.post("/tokens", {"name": f"client {role}", "role": role, "days": 1})["key"]

    return create


def test_ten_lines_take_download_and_solve_an_image(serve, new_token, tmp_path):
    """Command, telemetry, download, pixels as an array, solution, catalogue: as in docs/client.md."""
    server = serve("--simulator", "cubestar")
    with Client(server.console.address, new_token(server.console, "admin")) as gss:
        gss.wait_connected(60)
        with gss.authority():
            taken = gss.send("TAKE_IMAGE", exposure_ms=250)
            assert taken.result == "completed"
            temperature = gss.wait_telemetry("housekeeping.sensor_temperature_c", lambda value: value.state == "ok")
            assert isinstance(temperature.value, float)
            frame = gss.download_frame(slot=0)
            pixels = gss.pixels(frame)
            assert pixels.shape == (frame.rows, frame.columns)
            assert pixels.std() > 0
            solution = gss.solve(frame)
            assert solution.outcome == "solved"
            assert np.linalg.norm(solution.quaternion) == pytest.approx(1, abs=1e-6)
            catalogue = gss.build_catalogue(name="bright", profile="cubestar", faint_mag=3.5)
            assert gss.upload_catalogue(catalogue, "B").complete
        assert not gss._server.get("/authority")["mine"], "authority is released"
        assert gss.frames(outcome="solved")[0].id == frame.id
        assert "TAKE_IMAGE" in {command.name for command in gss.commands()}

    picture = tmp_path / "frame.png"
    picture.write_bytes(server.console.http.get(f"/frames/{frame.id}/image.png").content)
    with Client(server.console.address, new_token(server.console, "engineer")) as gss:
        assert gss.import_frame(picture, instrument="cubestar").source == "import"


def test_refusals_are_exceptions_with_the_servers_words(serve, new_token):
    """Wrong token, unknown command, bad argument, missing permission, refused by the sensor, no server."""
    server = serve("--simulator", "cubestar")
    address = server.console.address
    with Client(address, "wrong") as gss, pytest.raises(NotAllowed):
        gss.link()
    with Client(address, new_token(server.console, "viewer")) as gss, pytest.raises(NotAllowed, match="Permission"):
        gss.submit("TAKE_IMAGE")
    with Client(address, new_token(server.console)) as gss:
        gss.wait_connected(60)
        with gss.authority():
            with pytest.raises(ClientError, match="NO_SUCH"):
                gss.submit("NO_SUCH")
            with pytest.raises(ClientError, match="exposure_ms"):
                gss.submit("TAKE_IMAGE", exposure_ms=1e9)
            with pytest.raises(CommandFailed, match="MATCH_STARS"):
                gss.send("CALCULATE_ATTITUDE")
        with pytest.raises(KeyError):
            gss.wait_telemetry("housekeeping.no_such_field", lambda value: True, 1)
        with pytest.raises(TimedOut, match="last value is"):
            gss.wait_telemetry("housekeeping.sensor_temperature_c", lambda value: False, 0.5)
    with (
        Client("http://127.0.0.1:1", "none", reconnect_s=0) as gss,
        pytest.raises(ServerAway, match="does not respond"),
    ):
        gss.link()


def test_a_procedure_runs_to_its_end_or_stops_where_a_person_is_needed(serve, new_token):
    """Steps and answers run alone; a question without an answer and a hold point stop the run and are named."""
    server = serve("--simulator", "cubestar")
    server.console.post("/procedures", {"text": PROCEDURE})
    with Client(server.console.address, new_token(server.console)) as gss:
        gss.wait_connected(60)
        with gss.authority():
            ended = gss.run_procedure("Look at the sensor", answers={"free": "no"})
            assert (ended.state, [entry["step"] for entry in ended.entries]) == ("completed", ["status", "free"])
            assert len(ended.sha256) == 64
            with pytest.raises(ProcedureFailed, match="step free: a person must do this step"):
                gss.run_procedure("Look at the sensor")
            with pytest.raises(ProcedureFailed, match="step second: a person must do this step"):
                gss.run_procedure("Look at the sensor", answers={"free": "yes"})
        with pytest.raises(KeyError):
            gss.run_procedure("No such procedure")


def test_following_survives_a_restart_without_gap_or_double(serve, new_token):
    """Every stored packet and event arrives once and in order, across two restarts of the server, one by kill -9."""
    server = serve("--simulator", "cubestar")
    port = server.console.address.rsplit(":", 1)[1].strip("/")
    token = new_token(server.console)
    packets: list[Packet] = []
    ended = threading.Event()

    def follow() -> None:
        with Client(f"http://127.0.0.1:{port}", token, reconnect_s=120) as gss:
            for packet in gss.follow(after_id=0, poll_s=0.1):
                packets.append(packet)
                if ended.is_set():
                    return

    def some_more(console) -> None:
        before = len(packets)
        console.wait("packets", lambda: len(packets) > before + 5, 60)

    thread = threading.Thread(target=follow, daemon=True)
    thread.start()
    for ended_by_kill in (True, False):
        some_more(server.console)
        server.kill() if ended_by_kill else server.stop()
        server = serve("--simulator", "cubestar", "--port", port)
    some_more(server.console)
    ended.set()
    thread.join(30)
    assert not thread.is_alive()
    numbers = [packet.id for packet in packets]
    assert numbers == list(range(1, len(numbers) + 1))
    assert all(isinstance(packet.received, datetime) for packet in packets)

    with Client(f"http://127.0.0.1:{port}", token) as gss:
        events = gss.follow_events(after_seq=0)
        first = [next(events).seq for _ in range(5)]
    assert first == list(range(1, 6))


def test_pytest_plug_in_runs_tests_with_a_unit(serve, new_token, tmp_path):
    """One test passes, one fails with the last value; without a server they are skipped."""
    test = tmp_path / "test_unit.py"
    test.write_text(
        "def test_image(unit, assert_telemetry):\n"
        "    unit.send('TAKE_IMAGE', exposure_ms=250)\n"
        "    assert_telemetry('housekeeping.mode', lambda value: value.state == 'ok')\n"
        "def test_too_hot(assert_telemetry):\n"
        "    assert_telemetry('housekeeping.sensor_temperature_c', 999, within_s=0.5)\n"
        "def test_waits(wait_for):\n"
        "    assert wait_for('housekeeping.exposure_ms', lambda value: value.value is not None).unit == 'ms'\n"
    )
    server = serve("--simulator", "cubestar")
    token = new_token(server.console)
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-p",
        "gss.client.pytest_plugin",
        "-p",
        "no:cacheprovider",
        "-q",
        str(test),
    ]

    def run(*more: str) -> str:
        environment = {**os.environ, "GSS_TOKEN": token, "PYTHONPATH": str(Path(__file__).parents[2])}
        done = subprocess.run(
            [*command, *more], capture_output=True, text=True, cwd=tmp_path, env=environment, check=False, timeout=120
        )
        return done.stdout + done.stderr

    passed = run("--gss", server.console.address)
    assert "2 passed" in passed, passed
    assert "1 failed" in passed
    assert "its last value is" in passed
    assert "3 skipped" in run()

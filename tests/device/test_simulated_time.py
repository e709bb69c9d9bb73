"""Simulated time: real, faster, or stepped on command and then reproducible."""

from __future__ import annotations

import hashlib
import select
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from gss.device.session import HostSession
from gss.device.session_events import Telemetry
from gss.device.simulator.simulated_time import SimulatedClock, TimeControl
from gss.domain.errors import BadInput
from gss.instruments.dictionary.read_dictionary import load_dictionary


class Turns:
    """Count the turns of a terminal and store the time of each."""

    def __init__(self, clock: SimulatedClock) -> None:
        self.paced, self.clock, self.times_s = True, clock, []  # type: bool, SimulatedClock, list[float]

    def run_once(self, wait_s: float, extra_handles: list[int] | None = None) -> list[int]:
        self.times_s.append(self.clock())
        return []


def test_time_runs_at_its_speed_and_can_be_paused() -> None:
    """Ten times as fast; paused it does not advance; resumed it continues from there."""
    real = [100.0]
    clock = SimulatedClock(10.0, real=lambda: real[0])
    real[0] += 2.0
    assert clock() == pytest.approx(20.0)
    clock.hold()
    real[0] += 50.0
    assert clock() == pytest.approx(20.0)
    clock.advance(1.5)
    clock.run(2.0)
    real[0] += 1.0
    assert clock() == pytest.approx(23.5)
    with pytest.raises(BadInput, match="running"):
        clock.advance(1.0)
    for speed in (0.0, -1.0, 1001.0, float("nan")):
        with pytest.raises(BadInput, match="out of range"):
            SimulatedClock(speed)


def test_time_commands_are_executed_or_rejected_with_a_reason() -> None:
    """A step passes in ticks after received data were read; split and joined lines are the same; invalid text is an
    error.
    """
    clock = SimulatedClock(stopped=True)
    terminal = Turns(clock)
    desk = TimeControl(clock, terminal)
    assert list(desk.feed(b"st")) == []
    assert list(desk.feed(b"ep 0.5\ntime\n")) == ["time 0.500000", "time 0.500000"]
    ticks = [t for t in terminal.times_s if t > 0]
    assert len(ticks) == 50
    assert ticks[-1] == pytest.approx(0.5)
    assert terminal.times_s[0] == 0.0
    assert list(desk.feed(b"run\n")) == ["running"]
    assert terminal.paced
    assert next(iter(desk.feed(b"step 1\n"))).startswith("error the clock is running")
    assert next(iter(desk.feed(b"pause\n"))).startswith("paused ")
    assert not terminal.paced
    for wrong in (b"step\n", b"step x\n", b"step -1\n", b"step nan\n", b"run 1e9\n", b"dance\n", b"\xff\xfe\n"):
        assert next(iter(desk.feed(wrong))).startswith("error ")


class Stepped:
    """A simulator in stepped time with a connection."""

    def __init__(self, *options: str) -> None:
        command = [
            sys.executable,
            "-m",
            "gss.device.simulator",
            "--instrument",
            "cubestar",
            "--stepped",
            "--tcp",
            "0",
            *options,
        ]
        self.process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        ready = self.answer()
        if not ready.startswith("READY"):
            self.process.communicate(timeout=20)
            pytest.fail("the simulator did not start")
        port = int(ready.rsplit(":", 1)[1])
        self.peer = socket.create_connection(("127.0.0.1", port))
        time.sleep(0.1)

    def answer(self) -> str:
        assert self.process.stdout is not None
        return self.process.stdout.readline().strip()

    def order(self, text: str) -> str:
        assert self.process.stdin is not None
        self.process.stdin.write(text + "\n")
        self.process.stdin.flush()
        return self.answer()

    def received(self, quiet_s: float = 0.2) -> bytes:
        data = b""
        while select.select([self.peer], [], [], quiet_s)[0]:
            data += self.peer.recv(65536)
        return data

    def close(self) -> None:
        self.peer.close()
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                pipe.close()
        self.process.wait(20)


@pytest.fixture
def units() -> Iterator[list[Stepped]]:
    started: list[Stepped] = []
    yield started
    for unit in started:
        unit.close()


def _iteration(unit: Stepped) -> tuple[str, list[object]]:
    """Return a hash of all data sent in three seconds of stepped time with one iteration, and the reported centroids."""
    host, sent_hash, sent = HostSession(load_dictionary()), hashlib.sha256(), False
    host.link_up(0.0)
    centroids: list[object] = []
    for tick in range(30):
        now_s = tick * 0.1
        if host.hello is not None and not sent and now_s > 1.0:
            host.submit(host.encode("RUN_ITERATION", {"slot": 0}), request_id=77)
            sent = True
        out, _ = host.poll(now_s)
        unit.peer.sendall(out)
        assert unit.order("step 0.1").startswith("time ")
        data = unit.received(0.02)
        sent_hash.update(data)
        for event in host.feed(data, now_s):
            if isinstance(event, Telemetry) and event.packet == "centroids":
                centroids += [dict(row) for rows in event.lists.values() for row in rows]
    return sent_hash.hexdigest(), centroids


def test_stepped_time_gives_the_same_frame_twice(units: list[Stepped]) -> None:
    """The same commands at the same steps: two processes send identical bytes, including the simulated sky."""
    runs = []
    for _ in range(2):
        units.append(Stepped("--sky", "real", "--motion", "tumble", "--rate-deg-s", "0.1", "--seed", "3"))
        runs.append(_iteration(units[-1]))
    assert runs[0] == runs[1]
    assert len(runs[0][1]) > 3


def test_nothing_is_sent_while_time_is_paused(units: list[Stepped]) -> None:
    """Housekeeping is sent with the steps and not between them."""
    unit = Stepped()
    units.append(unit)
    assert unit.received() == b""
    assert unit.order("step 2.5") == "time 2.500000"
    assert len(unit.received()) > 200
    assert unit.received() == b""


def test_a_satellite_that_decays_ends_the_simulator_with_a_message(tmp_path: Path) -> None:
    """When the TLE of the simulator has no orbit any more, the process ends with the reason and without a traceback."""
    (tmp_path / "decay.tle").write_text(
        "1 40000U 14001A   26329.50000000  .01000000  00000-0  10000-2 0    15\n"
        "2 40000  51.6000  80.0000 0010000  10.0000 120.0000 16.25000000000016\n"
    )
    command = [sys.executable, "-m", "gss.device.simulator", "--instrument", "cubestar", "--stepped", "--tcp", "0"]
    command += ["--tle", str(tmp_path / "decay.tle")]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stdin is not None
        assert process.stderr is not None
        process.stdin.write("skip 700000\n")
        process.stdin.flush()
        assert process.wait(30) == 2
        assert process.stderr.read().startswith("simulator: No orbit at ")

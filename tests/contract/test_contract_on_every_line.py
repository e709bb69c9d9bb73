"""The same contract on every line: a device in this process, the simulator on a pseudo-terminal and on TCP, and a real port.

The real port is tried only where GSS_DEVICE_PORT names one; nothing is written to its flash.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from gss.device.clauses import CLAUSES
from gss.device.simulator.factory import burn_golden
from gss.device.simulator.firmware import StarTracker
from gss.device.simulator.machine import Identity, SimulatedDevice
from gss.device.simulator.memory import Memory
from gss.device.simulator.orbit import Inertial
from gss.device.simulator.sky import SimulatedSky
from gss.device.transport import open_stream
from gss.instruments.dictionary.read_dictionary import load_dictionary
from gss.instruments.golden import build_golden
from gss.instruments.registry import shipped_camera
from gss.operations.checks.check_device import check_device
from gss.operations.checks.check_findings import FAIL, PASS
from gss.operations.checks.probe import Probe

if TYPE_CHECKING:
    from conftest import Simulator

Start = Callable[..., "Simulator"]
Place = Callable[[str], Probe]
PORT = os.environ.get("GSS_DEVICE_PORT", "")
SIMULATED = ("memory", "pty", "tcp")
LINES = [*SIMULATED, pytest.param("port", marks=pytest.mark.skipif(not PORT, reason="GSS_DEVICE_PORT names no port"))]
FASTER = 5
pytestmark = pytest.mark.timeout(240)


class MemoryLine:
    """A line to a device in this process; simulated time advances only while a caller waits for bytes."""

    def __init__(self, camera: str) -> None:
        self.url, self.now_s = "memory", 100.0
        memory, own = Memory.in_ram(), shipped_camera(camera)
        burn_golden(memory, own, build_golden(own, memory.bank_bytes))
        motion = Inertial.pointing(np.radians(84.0), np.radians(5.0), 0.3)
        tracker = StarTracker(own, SimulatedSky(own, motion, 2026.0, 1), memory)
        self.device = SimulatedDevice(load_dictionary(), Identity(), memory, tracker, self.now_s)

    def read(self, max_bytes: int, timeout_s: float) -> bytes:
        del max_bytes, timeout_s
        self.now_s += 0.01
        self.device.advance(self.now_s)
        frames = []
        while (frame := self.device.next_frame(self.now_s)) is not None:
            frames.append(frame)
        return b"".join(frames)

    def write(self, data: bytes) -> None:
        self.device.feed(data, self.now_s)

    def close(self) -> None:
        """Do nothing; the line holds no resource."""


@pytest.fixture
def probe_at(simulator: Start, tmp_path: Path) -> Iterator[Place]:
    """Return a device that has identified itself, on the line of this name."""
    opened: list[Probe] = []

    def place(where: str, camera: str = "cubestar") -> Probe:
        if where == "memory":
            line = MemoryLine(camera)
            return Probe(line, load_dictionary(), lambda: line.now_s)
        url = PORT
        if where != "port":
            ends = ["--tcp", "0"] if where == "tcp" else ["--symlink", str(tmp_path / "port")]
            speed = ["--baud", "0", "--attitude", "84,5,20", "--motion", "inertial", "--speed", str(FASTER)]
            url = simulator(*ends, *speed, "--profile", camera).url
        opened.append(Probe(open_stream(url), load_dictionary(), time.monotonic))
        return opened[-1]

    yield place
    for probe in opened:
        probe.tap.close()


@pytest.mark.parametrize("where", LINES)
def test_every_clause_that_can_be_tried_holds(probe_at: Place, where: str) -> None:
    """The device passes every clause that can be checked, on every line."""
    findings = check_device(probe_at(where), write=where in SIMULATED)
    assert [(c.number, [x for x in findings.cases[c.number] if x.passed is False]) for c in findings.failed] == []
    assert findings.not_restored == []
    results = [findings.result(c) for c in CLAUSES]
    assert FAIL not in results
    assert results.count(PASS) >= 35


@pytest.mark.parametrize("camera", ["sunsat", "oersted", "far_mst", "aim"])
def test_the_other_cameras_keep_the_contract_too(probe_at: Callable[..., Probe], camera: str) -> None:
    """Devices with other cameras, chains and formats also pass every clause."""
    findings = check_device(probe_at("memory", camera), write=True)
    assert [(c.number, [x for x in findings.cases[c.number] if x.passed is False]) for c in findings.failed] == []
    assert findings.not_restored == []


def test_bit_errors_are_injected_into_the_line_of_a_running_simulator(probe_at: Place) -> None:
    """With injected bit errors on a real line, each command is lost or carried out, and none is misread. Without them, all
    commands are completed."""
    probe = probe_at("tcp")
    assert probe.order("SIM_SET_LINE", {"direction": "up", "bit_error_rate": 0.002}).is_("completed")
    answers = []
    while len(answers) < 30 and (not answers or answers[-1].reports):
        answers.append(probe.order("GET_STATUS"))
    assert not answers[-1].reports
    assert all(a.is_("completed") for a in answers[:-1])
    for _ in range(20):
        if probe.order("SIM_SET_LINE", {"direction": "both"}).is_("completed"):
            break
    assert all(probe.order("GET_STATUS").is_("completed") for _ in range(5))
    assert int(probe.status()["frames_bad"]) >= 1

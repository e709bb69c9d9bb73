"""Images that a sensor sends as files are downloaded over a real bus, parsed, stored and solved once each."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from gss.domain.frames import cam_from_icrs
from gss.domain.rotation import matrix_from_quaternion
from gss.settings import Settings
from gss.wiring.build import build
from gss.wiring.services import Services

pytestmark = pytest.mark.timeout(240)
TRUE = cam_from_icrs(*np.radians([84.0, 5.0, 30.0]))


@pytest.fixture
def bus() -> Iterator[str]:
    """Address of a simulated OreSat star tracker that supports block transfers."""
    command = [sys.executable, "-m", "gss.device.simulator", "--instrument", "oresat", "--dialect", "block"]
    command += ["--motion", "inertial", "--attitude", "84,5,30", "--baud", "0", "--exit-with-stdin"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        assert process.stdout is not None
        yield process.stdout.readline().removeprefix("READY ").strip()
        process.terminate()


@pytest.fixture
def services(tmp_path: Path, bus: str) -> Iterator[Services]:
    """Services of a server with the sensor on this bus."""
    services = build(Settings(data=tmp_path, instrument="oresat", device=bus))
    services.start()
    yield services
    services.stop()


def wait_for(ready: Callable[[], Any]) -> Any:
    """Return the first true value. The timeout of the test limits the wait."""
    while not (value := ready()):
        time.sleep(0.05)
    return value


def test_a_preview_is_downloaded_parsed_stored_and_solved_once(services: Services, bus: str) -> None:
    """A preview is stored and solved with the attitude of the motion. After the line was reopened, the same image is not
    downloaded again."""
    wait_for(lambda: services.line.link.connected and services.line.link.hello)
    link, capture = services.line.link, {"status": "capture"}
    with link.lock:
        link.session.submit(link.session.encode("SET_STATUS", capture))
    _, rows = wait_for(lambda: (page := services.frames.frames.page(10, 0))[0] and page[1][0][1] and page)
    frame, solution = rows[0]
    assert (frame.columns, frame.rows, frame.bits, frame.profile, frame.complete) == (640, 480, 8, "oresat", True)
    assert solution.outcome == "solved"
    difference = np.abs(matrix_from_quaternion(np.array(solution.quaternion)) - TRUE).max()
    assert difference < 1e-3
    contact = link.contact_id
    link.open(bus)
    wait_for(lambda: link.contact_id != contact and link.connected and link.hello)
    with link.lock:
        link.session.submit(link.session.encode("SET_STATUS", capture))
    total, rows = wait_for(lambda: (page := services.frames.frames.page(10, 0))[0] > 1 and page)
    assert total == 2
    assert rows[0][0].number > rows[1][0].number == frame.number

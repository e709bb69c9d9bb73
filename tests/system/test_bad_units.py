"""Defects of units on one server: broken package, drivers that raise, hang or stop the whole process, a wrong line rate and
another dictionary. The fleet reports a state for each, a restart of one unit ends a hang, and the other units are not
affected. Two units on one line and a line with noise are in ``test_new_unit.py``."""

from __future__ import annotations

import re
import shutil
import socket
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx2
import pytest

from gss.instruments.registry import SHIPPED

pytestmark = pytest.mark.timeout(2400)
LONG_S = 900.0
DICTIONARY = SHIPPED.parent / "dictionary"
DRIVERS = """
import ctypes
import time
from pathlib import Path
from gss.device import link_driver

class Faulty:
    def __init__(self, session, fault):
        self._session, self._fault = session, fault

    def __getattr__(self, name):
        return getattr(self._session, name)

    def feed(self, data, now_s):
        if Path(__file__).with_name(self._fault.__name__).exists():
            self._fault()
        return self._session.feed(data, now_s)

def no_field():
    raise ValueError("no such field")

def hang():
    time.sleep(600)

def freeze():
    ctypes.PyDLL(None).sleep(600)  # PyDLL keeps the lock of the interpreter

def raises(setup):
    return Faulty(link_driver.open_session(setup), no_field)

def hangs(setup):
    return Faulty(link_driver.open_session(setup), hang)

def freezes(setup):
    return Faulty(link_driver.open_session(setup), freeze)
"""
EXPECTED = {
    "BROKEN": "must be one of",
    "RAISES": "Line down: ValueError: no such field",
    "HANGS": "the driver of the instrument hangs: restart the unit",
    "BAUD": "Bytes arrive, but no valid packet for 3 s: check the line rate and the instrument",
    "DICT": "Dictionary differs from the device's",
}
"""What the fleet reports of each unit: the reason why its process cannot start, or an alarm."""


@pytest.fixture
def packages(tmp_path: Path) -> Path:
    """Folder of a Python package with the drivers. The data folder has an instrument for each, a broken one, and a CubeStar
    with another version of the dictionary. A fault of a driver is on while a file with its name exists in the folder."""
    code = tmp_path / "code"
    (code / "faulty-1.dist-info").mkdir(parents=True)
    (code / "faulty.py").write_text(DRIVERS)
    (code / "faulty-1.dist-info" / "METADATA").write_text("Metadata-Version: 2.1\nName: faulty\nVersion: 1\n")
    names = ("raises", "hangs", "freezes")
    entries = "".join(f"{name} = faulty:{name}\n" for name in names)
    (code / "faulty-1.dist-info" / "entry_points.txt").write_text(f"[gss.drivers]\n{entries}")
    for fault in ("no_field", "hang"):
        (code / fault).touch()
    for name in (*names, "broken"):
        folder = _copy(tmp_path, "nos3", name)
        about = (folder / "instrument.yaml").read_text()
        (folder / "instrument.yaml").write_text(about.replace("driver: link", f"driver: {name}"))
        link = (folder / "link.yaml").read_text()
        (folder / "link.yaml").write_text(link.replace("stalled_after_s: 20.0", "stalled_after_s: 1.0"))
    folder = _copy(tmp_path, "cubestar", "dict")
    about = (folder / "instrument.yaml").read_text()
    (folder / "instrument.yaml").write_text(about.replace("dictionary: gss-common\n", ""))
    text = (DICTIONARY / "gss-common.yaml").read_text()
    text = re.sub(r"^same_layout_as:.*\n(?:  - .*\n)*", "", text, flags=re.MULTILINE)
    (folder / "dictionary.yaml").write_text(re.sub(r"^version: \d+", "version: 99", text, flags=re.MULTILINE))
    shutil.copy(DICTIONARY / "gss-common.operations.yaml", folder / "operations.yaml")
    return code


def _copy(tmp_path: Path, shipped: str, name: str) -> Path:
    folder = tmp_path / "data" / "instruments" / name
    shutil.copytree(SHIPPED / shipped, folder)
    about = (folder / "instrument.yaml").read_text()
    (folder / "instrument.yaml").write_text(about.replace(f"id: {shipped}", f"id: {name}"))
    return folder


def at_rate(sent: bytes, ratio: float) -> bytes:
    """Return what a receiver reads from bytes of another line rate: it samples start bit, eight data bits and stop bit (8N1)
    in its own bit times. ``ratio``: rate of the receiver divided by the rate of the sender."""
    levels = [bit for byte in sent for bit in (0, *((byte >> k) & 1 for k in range(8)), 1)]
    received, at = bytearray(), 0.0

    def level(time: float) -> int:
        return levels[int(time)] if time < len(levels) else 1

    while at < len(levels):
        if level(at):
            at = int(at) + 1.0
            continue
        received.append(sum(level(at + (1.5 + k) / ratio) << k for k in range(8)))
        at += 9.5 / ratio
    return bytes(received)


@pytest.fixture
def wrong_rate(sensor: Any) -> Iterator[str]:
    """Address of a line to a simulated CubeStar that the ground reads with half the rate."""
    ended = threading.Event()
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def serve() -> None:
            while not ended.is_set():
                try:
                    ground, _ = listener.accept()
                    with ground, socket.create_connection(("127.0.0.1", sensor.port)) as line:
                        while not ended.is_set() and (data := line.recv(4096)):
                            ground.sendall(at_rate(data, 0.5))
                except OSError:
                    continue  # the server closed the line, or the test has ended

        listener.settimeout(0.5)
        thread = threading.Thread(target=serve)
        thread.start()
        yield f"socket://127.0.0.1:{listener.getsockname()[1]}"
        ended.set()
        sensor.stop()
        thread.join()


@pytest.fixture
def second_sensor(tmp_path: Path, run_gss: Callable[..., Any]) -> str:
    """Address of another simulated CubeStar."""
    simulator = run_gss("simulate", "--instrument", "cubestar", "--tcp", "0", "--state-dir", str(tmp_path / "second"))
    return str(next(line for line in simulator.stdout if line.startswith("READY")).split()[1])


def test_each_defect_has_a_clear_state_and_costs_the_other_units_nothing(
    start_units: Callable[..., Any], packages: Path, wrong_rate: str, second_sensor: str
) -> None:
    """The fleet reports what is wrong with each unit. During all this, the good unit has one contact without a gap."""
    simulated = [f"{unit}={unit.lower()}@simulator" for unit in ("RAISES", "HANGS", "FREEZES", "BROKEN")]
    lines = [f"BAUD=cubestar@{wrong_rate}", f"DICT=dict@{second_sensor}"]
    units = start_units("GOOD=nos3@simulator", *simulated, *lines, PYTHONPATH=str(packages))

    def state(name: str) -> str:
        unit = units.fleet()[name]
        alarms = unit["link"]["alarms"] if unit["current"] else []
        return "; ".join([unit["reason"], *(alarm["text"] for alarm in alarms)])

    contact = units.connected("GOOD", "FREEZES")["GOOD"]["link"]["contact_id"]
    for name, words in EXPECTED.items():
        units.console.wait(f"{name}: {words}", lambda name=name, words=words: words in state(name), LONG_S)
    with units.http("RAISES") as http:
        assert len(http.get("/contacts").json()) == 1, "the attempts are one contact"
    with units.http("DICT") as http:
        answer = http.post("/commands", json={"name": "GET_STATUS", "arguments": {}, "confirm": ""})
        assert (answer.status_code, "acknowledge" in answer.json()["hint"]) == (409, True)
    _a_restart_ends_a_hang(units, packages)
    broken = units.fleet()["BROKEN"]
    assert (broken["process"], broken["restarts"]) == ("ended", 0), "a process was started with an invalid package"
    good = units.fleet()["GOOD"]
    assert (good["restarts"], good["link"]["contact_id"], good["link"]["rx"]["state"]) == (0, contact, "up")
    with units.http("GOOD") as http:
        answer = http.get(f"/contacts/{contact}")
        assert (answer.status_code, answer.json().get("gaps")) == (200, []), answer.text


def _a_restart_ends_a_hang(units: Any, packages: Path) -> None:
    """A driver that hangs, and one that stops all threads of its process, are ended by a restart of that unit only."""
    (packages / "freeze").touch()
    units.console.wait("the end of the reports", lambda: not units.fleet()["FREEZES"]["current"], LONG_S)
    for name, fault in (("HANGS", "hang"), ("FREEZES", "freeze")):
        (packages / fault).unlink()
        before = units.fleet()
        assert units.console.http.post(f"/fleet/units/{name}/restart").status_code == 204
        after = units.connected(name)
        assert (after[name]["restarts"], after[name]["last_end"]) == (before[name]["restarts"] + 1, "user admin")
        restarted = [n for n in after if after[n]["restarts"] > before[n]["restarts"] and n != name]
        assert restarted == []
    rows = [row for row in units.console.get("/audit") if row["action"] == "fleet.restart_unit"]
    assert [(row["who"], row["result"], row["detail"]) for row in rows] == [
        ("admin", "done", "FREEZES"),
        ("admin", "done", "HANGS"),
    ]
    texts = [event["text"] for event in units.console.get("/events")]
    assert "unit HANGS ended (user admin); restarting it" in texts


def test_a_restart_is_refused_if_it_cannot_be_meant(
    start_units: Callable[..., Any], tmp_path: Path, signed_in: Callable[..., dict[str, str]]
) -> None:
    """It needs the permission for opening the line, and the name of a unit."""
    units = start_units("GOOD=nos3@simulator")
    viewer = signed_in(tmp_path / "data", "viewer")
    url = f"{units.console.address}/api/fleet/units"
    assert httpx2.post(f"{url}/GOOD/restart", headers=viewer).status_code == 403
    answer = units.console.http.post("/fleet/units/GOD/restart")
    assert (answer.status_code, answer.json()["expected"]) == (404, "one of GOOD")
    assert units.fleet()["GOOD"]["restarts"] == 0

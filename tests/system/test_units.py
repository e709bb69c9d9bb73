"""Several units on one server: each has a separate process and separate data."""

from __future__ import annotations

import os
import signal
from collections.abc import Callable
from pathlib import Path
from typing import Any

import httpx2
import pytest

from gss.operations.folder_lock import folder_lock

pytestmark = pytest.mark.timeout(900)
LONG_S = 300.0


class Units:
    """Client of a server with units."""

    def __init__(self, server: Any) -> None:
        self.server, self.console = server, server.console

    def fleet(self) -> dict[str, Any]:
        return {unit["name"]: unit for unit in self.console.get("/fleet")["units"]}

    def http(self, name: str) -> httpx2.Client:
        """A client of one unit."""
        return httpx2.Client(
            base_url=f"{self.console.address}/units/{name}/api", headers=self.console.headers, timeout=30
        )

    def connected(self, *names: str) -> dict[str, Any]:
        """Wait until these units have a line and telemetry; return the fleet."""

        def there() -> dict[str, Any] | None:
            units = self.fleet()
            good = all(units[n]["current"] and units[n]["link"]["rx"]["state"] == "up" for n in names)
            return units if good else None

        return self.console.wait(f"{names} to be connected", there, LONG_S)


@pytest.fixture
def units(serve: Callable[..., Any]) -> Units:
    return Units(serve("--unit", "FM1=cubestar@simulator", "--unit", "EM-2=nos3@simulator"))


def test_two_units_of_different_instruments_run_in_one_console(units: Units) -> None:
    """Each unit has its own line, telemetry, commands and pages; the accounts are those of the server."""
    fleet = units.connected("FM1", "EM-2")
    assert [fleet[n]["instrument"] for n in ("FM1", "EM-2")] == ["cubestar", "nos3"]
    with units.http("FM1") as first, units.http("EM-2") as second:
        names = [{c["name"] for c in http.get("/dictionary").json()["commands"]} for http in (first, second)]
        assert "START_CYCLE" in names[0]
        assert "START_CYCLE" not in names[1]
        sent = first.post("/commands", json={"name": "GET_STATUS", "arguments": {}, "confirm": ""})
        assert sent.status_code == 201, sent.text
        rows = [{row["name"] for row in http.get("/commands").json()} for http in (first, second)]
        assert "GET_STATUS" in rows[0]
        assert not rows[1] & names[0]
        assert first.get("/session").json()["signed_in"]
        aborted = second.post("/commands/abort")
        assert aborted.status_code < 500, aborted.text
    page = httpx2.get(f"{units.console.address}/units/FM1/live")
    assert page.status_code == 200
    assert "<!doctype html>" in page.text.lower()
    _attitude_arrives(units)
    _wrong_names_and_strangers_are_refused(units)


def test_a_killed_unit_comes_back_and_the_others_notice_nothing(units: Units) -> None:
    """A killed process of a unit is started again. The other unit keeps its contact."""
    fleet = units.connected("FM1", "EM-2")
    contact = fleet["EM-2"]["link"]["contact_id"]
    pid = next(child for child in _children(units.server.process.pid) if _data_of(child).endswith("units/FM1"))
    os.kill(pid, signal.SIGKILL)
    gone = units.console.wait("the loss", lambda: (u := units.fleet()["FM1"])["restarts"] and u, LONG_S)
    assert gone["last_end"] == "signal 9"
    again = units.connected("FM1", "EM-2")
    assert again["FM1"]["restarts"] == 1
    assert again["EM-2"]["restarts"] == 0
    assert again["EM-2"]["link"]["contact_id"] == contact
    with units.http("EM-2") as http:
        assert not [e for e in http.get("/events").json() if "lost" in e["text"].lower()]


def _attitude_arrives(units: Units) -> None:
    """NOS3 sends its attitude on request; the fleet page shows it with its age."""
    with units.http("EM-2") as http:
        http.post("/commands", json={"name": "ENABLE", "arguments": {}, "confirm": ""})
    seen = units.console.wait("an attitude", lambda: units.fleet()["EM-2"]["link"]["attitude"], LONG_S)
    assert -90 <= seen["dec_deg"] <= 90
    assert seen["age_s"] < 60


def _wrong_names_and_strangers_are_refused(units: Units) -> None:
    """The response to an unknown unit lists the known units; a request without an account is rejected."""
    with units.http("FM9") as http:
        answer = http.get("/link")
        assert answer.status_code == 404
        assert "FM1, EM-2" in answer.json()["expected"]
    address = units.console.address
    assert httpx2.get(f"{address}/units/FM1/api/link").status_code == 401
    assert httpx2.get(f"{address}/api/fleet").status_code == 401


def test_a_unit_that_cannot_start_says_why_and_starts_later(serve: Callable[..., Any], tmp_path: Path) -> None:
    """Its folder is in use: the fleet shows the reason, the other unit works, and it starts when the folder is free."""
    with folder_lock(tmp_path / "data" / "units" / "FM1"):
        units = Units(serve("--unit", "FM1=nos3@simulator", "--unit", "EM-2=nos3@simulator"))
        reason = units.console.wait("the reason", lambda: units.fleet()["FM1"]["reason"], LONG_S)
        assert "another GSS server uses this data folder" in reason
        units.connected("EM-2")
        with units.http("FM1") as http:
            answer = http.get("/link")
            assert answer.status_code == 503
            assert "unit FM1" in answer.json()["message"]
    units.connected("FM1", "EM-2")
    assert units.fleet()["FM1"]["reason"] == ""


def _children(pid: int) -> list[int]:
    """Return the child processes of all threads of a process."""
    return [
        int(word) for task in Path(f"/proc/{pid}/task").iterdir() for word in (task / "children").read_text().split()
    ]


def _data_of(pid: int) -> str:
    """Return the folder whose lock the process holds."""
    for descriptor in os.listdir(f"/proc/{pid}/fd"):
        target = os.readlink(f"/proc/{pid}/fd/{descriptor}")
        if target.endswith("server.lock"):
            return os.path.dirname(target)
    return ""

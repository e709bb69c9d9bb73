"""Several units on one server: each has a separate process and separate data."""

from __future__ import annotations

import os
import re
import signal
from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import httpx2
import pytest

from gss.cli import main
from gss.operations.folder_lock import folder_lock

pytestmark = pytest.mark.timeout(1800)
LONG_S = 600.0
ENDED = ("completed", "rejected", "failed", "unknown")
NO_LOSS = {"gaps": 0, "bad_crc": 0, "too_long": 0, "too_short": 0}
"""Counters of a line on which no packet was lost or damaged."""


@pytest.fixture
def units(start_units: Callable[..., Any]) -> Any:
    return start_units("FM1=cubestar@simulator", "EM-2=nos3@simulator")


def test_two_units_of_different_instruments_run_in_one_console(units: Any) -> None:
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
        start_page = first.put("/session/start-page", json={"path": "/frames/12"})
        assert (start_page.status_code, start_page.json()["got"]) == (400, "/frames/12")
        assert first.put("/session/start-page", json={"path": "/frames"}).json()["start_page"] == "/frames"
        aborted = second.post("/commands/abort")
        assert aborted.status_code < 500, aborted.text
    page = httpx2.get(f"{units.console.address}/units/FM1/live")
    assert page.status_code == 200
    assert "<!doctype html>" in page.text.lower()
    _attitude_arrives(units)
    _wrong_names_and_strangers_are_refused(units)


def test_killing_one_of_four_units_costs_the_others_nothing(start_units: Callable[..., Any]) -> None:
    """``kill -9`` of one process while the three others transfer: an image, an image by SDO, and centroids without request.
    These transfers complete in the same contacts, and no packet is missing. The killed process is started again."""
    names = ("FM1", "EM-2", "SAG", "ORE")
    instruments = ("cubestar", "nos3", "sagitta", "oresat")
    simulated = [f"{name}={instrument}@simulator" for name, instrument in zip(names, instruments, strict=True)]
    # At this line rate an image takes about 20 s, so that the loss is during its download.
    units = start_units(*simulated, GSS_SIMULATOR_BAUD="460800")
    before = units.connected(*names)
    others = ("FM1", "SAG", "ORE")
    with units.http("FM1") as fm1, units.http("SAG") as sag, units.http("ORE") as ore:
        _command(units, sag, "BOOT")
        _command(units, sag, "SET_SUBSCRIPTION", telemetry_1=37)
        _command(units, fm1, "TAKE_IMAGE")
        _command(units, ore, "SET_STATUS", status="capture")
        for http in (fm1, ore):
            units.console.wait("a download", lambda http=http: _download(http)["stored_bytes"] > 0, LONG_S)
        centroids = units.console.wait("centroids", lambda: _newest(sag, "centroids"), LONG_S)

        pid = next(child for child in _children(units.server.process.pid) if _data_of(child).endswith("units/EM-2"))
        os.kill(pid, signal.SIGKILL)
        killed = datetime.now(UTC)
        under_way = [_download(http) for http in (fm1, ore)]
        assert [row["finished"] for row in under_way] == [None, None]
        gone = units.console.wait("the loss", lambda: (u := units.fleet()["EM-2"])["restarts"] and u, LONG_S)
        assert gone["last_end"] == "signal 9"
        for http in (fm1, ore):
            units.console.wait("the image", lambda http=http: _download(http)["finished"], LONG_S)
        units.console.wait("more centroids", lambda: _newest(sag, "centroids") > centroids, LONG_S)
        after = units.connected(*names)

        assert [after[name]["restarts"] for name in names] == [0, 1, 0, 0]
        for http, started in zip((fm1, ore), under_way, strict=True):
            done = _download(http)
            assert (done["id"], done["state"], done["stored_bytes"]) == (started["id"], "verified", done["size"])
            assert [frame["complete"] for frame in http.get("/frames?source=device").json()["frames"]] == [True]
        for name, http in zip(others, (fm1, sag, ore), strict=True):
            contact = after[name]["link"]["contact_id"]
            assert contact == before[name]["link"]["contact_id"]
            received = http.get("/link/counters").json()["received"]
            assert {key: received[key] for key in ("gaps", "bad_crc", "too_long", "too_short")} == NO_LOSS, name
            gaps = http.get(f"/contacts/{contact}").json()["gaps"]
            assert [gap for gap in gaps if datetime.fromisoformat(gap["end"]) > killed] == [], name
        record = fm1.get(f"/contacts/{after['FM1']['link']['contact_id']}/record").json()
        assert [gap for gap in record["gaps"] if gap["missing"]] == []


def _command(units: Any, http: httpx2.Client, name: str, **arguments: Any) -> None:
    """Send a command of one unit until it is completed. On a busy machine a simulator can respond after the time limit, and
    the result of the command is then unknown."""
    result = "unknown"
    while result == "unknown":
        sent = http.post("/commands", json={"name": name, "arguments": arguments, "confirm": ""})
        assert sent.status_code == 201, sent.text
        url = f"/commands/{sent.json()['id']}"
        result = units.console.wait(f"the end of {name}", lambda url=url: _result(http.get(url).json()), LONG_S)
    assert result == "completed", f"{name} {result}"


def _result(command: dict[str, Any]) -> str:
    """Return the result of a command that has ended, otherwise ""."""
    return str(command["result"]) if command["result"] in ENDED else ""


def _download(http: httpx2.Client) -> dict[str, Any]:
    """Return the newest image transfer of a unit; its number of stored bytes is 0 while there is none."""
    rows = [row for row in http.get("/transfers").json() if row["kind"] == "frame"]
    return dict(max(rows, key=lambda row: row["id"])) if rows else {"stored_bytes": 0}


def _newest(http: httpx2.Client, packet: str) -> int:
    """Return the id of the newest stored packet of one kind; 0 if there is none."""
    rows = http.get("/telemetry/packets", params={"packet": packet, "limit": 1}).json()
    return int(rows[0]["id"]) if rows else 0


def _attitude_arrives(units: Any) -> None:
    """NOS3 sends its attitude on request; the fleet page shows it with its age."""
    with units.http("EM-2") as http:
        http.post("/commands", json={"name": "ENABLE", "arguments": {}, "confirm": ""})
    seen = units.console.wait("an attitude", lambda: units.fleet()["EM-2"]["link"]["attitude"], LONG_S)
    assert -90 <= seen["dec_deg"] <= 90
    assert seen["age_s"] < 60


def _wrong_names_and_strangers_are_refused(units: Any) -> None:
    """The response to an unknown unit lists the known units; a request without an account is rejected."""
    with units.http("FM9") as http:
        answer = http.get("/link")
        assert answer.status_code == 404
        assert "FM1, EM-2" in answer.json()["expected"]
    address = units.console.address
    assert httpx2.get(f"{address}/units/FM1/api/link").status_code == 401
    assert httpx2.get(f"{address}/api/fleet").status_code == 401


def test_a_unit_that_cannot_start_says_why_and_starts_later(
    start_units: Callable[..., Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Its folder is in use: the fleet shows the reason, the other unit works, and it starts when the folder is free.
    ``gss fleet`` lists the units and restarts one of them."""
    with folder_lock(tmp_path / "data" / "units" / "FM1"):
        units = start_units("FM1=nos3@simulator", "EM-2=nos3@simulator")
        reason = units.console.wait("the reason", lambda: units.fleet()["FM1"]["reason"], LONG_S)
        assert "another GSS server uses this data folder" in reason
        units.connected("EM-2")
        with units.http("FM1") as http:
            answer = http.get("/link")
            assert answer.status_code == 503
            assert "unit FM1" in answer.json()["message"]
    units.connected("FM1", "EM-2")
    assert units.fleet()["FM1"]["reason"] == ""
    monkeypatch.setenv("GSS_ADDRESS", units.console.address)
    monkeypatch.setenv("GSS_TOKEN", units.console.post("/tokens", {"name": "lab", "role": "admin", "days": 1})["key"])
    _restarted_from_the_shell(units, capsys)


def _restarted_from_the_shell(units: Any, capsys: pytest.CaptureFixture[str]) -> None:
    """A wrong name is an error that lists the units. The restart of one unit is shown in the list."""
    before = units.fleet()
    assert main(["fleet", "restart", "FM9"]) == 2
    assert "FM1, EM-2" in capsys.readouterr().err
    assert main(["fleet", "restart", "EM-2"]) == 0
    assert capsys.readouterr().out == "EM-2 is restarted\n"
    units.console.wait("the end", lambda: units.fleet()["EM-2"]["restarts"] > before["EM-2"]["restarts"], LONG_S)
    after = units.connected("FM1", "EM-2")
    assert after["FM1"]["restarts"] == before["FM1"]["restarts"]
    assert main(["fleet", "list"]) == 0
    line = next(text for text in capsys.readouterr().out.splitlines() if text.startswith("EM-2"))
    assert re.search(r"nos3 +running +\d+ restarts, last ended by user .*lab", line)


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

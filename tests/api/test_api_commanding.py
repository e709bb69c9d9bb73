"""Commanding over HTTP, against a sensor in memory: authority, commands, procedures, schedule, history."""

from __future__ import annotations

import csv
import io
import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from typing import Any

import pytest
from fastapi.testclient import TestClient

from gss.operations.clock import Clock
from gss.settings import Settings
from gss.wiring.build import build

pytestmark = pytest.mark.timeout(120)
ENDED = ("completed", "rejected", "failed", "unknown", "withdrawn")


class ConsoleClient:
    """Console client of a server with a sensor. Requests name a ``user``, who is created as an admin if unknown."""

    def __init__(
        self, client: TestClient, services: Any, sensor: Any, signed_in: Callable[..., dict[str, str]]
    ) -> None:
        self.client, self.services, self.sensor, self.signed_in = client, services, sensor, signed_in
        self.headers: dict[str, dict[str, str]] = {}

    def request(self, method: str, path: str, status: int = 200, user: str = "ann", **options: Any) -> Any:
        if user not in self.headers:
            self.headers[user] = self.signed_in(self.services, "admin", user)
        reply = self.client.request(method, f"/api{path}", headers=self.headers[user], **options)
        assert reply.status_code == status, reply.text
        return reply.json() if reply.content else None

    def wait(self, condition: Callable[[], Any]) -> Any:
        limit_s = time.monotonic() + 90
        while not (result := condition()):
            assert time.monotonic() < limit_s, self.request("GET", "/events")[-3:]
            time.sleep(0.01)
        return result

    def send(self, name: str, status: int = 201, user: str = "ann", confirm: str = "", **arguments: Any) -> Any:
        body = {"name": name, "arguments": arguments, "confirm": confirm}
        return self.request("POST", "/commands", status, user, json=body)

    def end(self, row: Any) -> Any:
        return self.wait(
            lambda: next((c for c in [self.request("GET", f"/commands/{row['id']}")] if c["result"] in ENDED), 0)
        )


@pytest.fixture
def make_console(tmp_path, sensor_in_memory, signed_in, client_of) -> Iterator[Callable[..., ConsoleClient]]:
    """Factory of consoles on simulated sensors. The link is open and the sensor has identified itself."""
    clients: list[TestClient] = []

    def make(**identity: Any) -> ConsoleClient:
        sensor = sensor_in_memory(**identity)
        start = datetime.now(UTC)
        services = build(
            Settings(data=tmp_path / "data"),
            clock=Clock(lambda: start + timedelta(seconds=sensor.now_s), sensor.monotonic_s),
        )
        sensor.keep_pace_with(services.line.link.events)
        client = client_of(services)
        clients.append(client.__enter__())
        services.line.link.open_later(sensor.url)
        console = ConsoleClient(client, services, sensor, signed_in)
        console.wait(lambda: console.request("GET", "/link")["dictionary_match"])
        console.wait(lambda: console.request("GET", "/schedule")["reported"])
        return console

    yield make
    for client in clients:
        client.__exit__(None, None, None)


@pytest.fixture
def console(make_console) -> ConsoleClient:
    """A console on a simulated sensor."""
    return make_console()


def test_authority_is_taken_released_and_broken(console):
    """Responses, header and rejected commands name the holder of the authority. Breaking it needs a reason."""
    free = console.request("GET", "/authority")
    assert (free["holder"], free["mine"], free["history"]) == (None, False, [])
    taken = console.request("POST", "/authority/take")
    assert (taken["holder"], taken["mine"]) == ("ann", True)
    assert console.request("GET", "/authority", user="bob")["mine"] is False
    assert console.request("GET", "/link")["authority"] == "ann"
    rejected = console.send("GET_STATUS", 409, user="bob")
    assert (rejected["message"], rejected["got"]) == ("Command authority is held by ann.", "")
    console.request("POST", "/authority/release", 409, user="bob")
    console.request("POST", "/authority/break", 422, user="bob", json={"reason": ""})
    console.request("POST", "/authority/break", 400, user="bob", json={"reason": "   "})
    broken = console.request("POST", "/authority/break", user="bob", json={"reason": "pass begins"})
    assert (broken["holder"], broken["history"][1]["reason"]) == ("bob", "pass begins")
    assert console.request("POST", "/authority/release", user="bob")["holder"] is None
    kinds = [e["text"] for e in console.request("GET", "/events") if e["kind"] == "authority"]
    assert kinds == [
        "ann took command authority",
        "bob broke the command authority of ann: pass begins",
        "bob released command authority",
    ]


def test_authority_is_handed_over_by_both_sides(console, signed_in):
    """Only the other side answers a request or an offer, one at a time. The history records the notes."""
    signed_in(console.services, "viewer", "eve")

    def post(action: str, status: int = 200, user: str = "ann", to: str = "", note: str = "") -> Any:
        body = {"note": note} | ({"user": to} if to else {})
        return console.request("POST", f"/authority/{action}", status, user=user, json=body)

    post("request", 409, user="bob")
    post("take")
    requested = post("request", user="bob", note="  pass   begins ")
    assert (requested["holder"], requested["transfer"]["kind"]) == ("ann", "request")
    assert (requested["transfer"]["user"], requested["transfer"]["note"]) == ("bob", "pass begins")
    assert "waits for an answer" in post("offer", 409, to="bob")["message"]
    post("accept", 409, user="bob")
    assert post("decline", note="not now")["transfer"] is None
    post("request", user="bob")
    assert post("accept", note="heater is on")["holder"] == "bob"
    for name in ("eve", "bob", "ghost"):
        assert "cannot be offered" in post("offer", 404, user="bob", to=name)["message"]
    post("offer", user="bob", to="ann", note="end of shift")
    assert post("accept", user="ann")["history"][1]["reason"] == "handed over to ann: end of shift"
    kinds = [e["text"] for e in console.request("GET", "/events") if e["kind"] == "authority"]
    assert kinds[1:] == [
        "bob requested command authority from ann: pass begins",
        "ann refused bob's request of command authority: not now",
        "bob requested command authority from ann",
        "ann handed command authority over to bob: heater is on",
        "bob offered command authority to ann: end of shift",
        "bob handed command authority over to ann: end of shift",
    ]


def test_a_command_is_checked_sent_and_stored(console):
    """A check reports hazard, role and authority. The stored command has the fields that the console shows."""
    check = console.request("POST", "/commands/check", json={"name": "POWER", "arguments": {"state": "off"}})
    assert (check["hazard"], check["confirm_name"], check["role"]) == ("warning", "POWER", "operator")
    assert (check["allowed"], check["problems"], check["authority"]) == (True, [], None)
    assert [g["label"] for g in check["bytes"] if g["argument"]] == ["rail", "state"]
    assert "POWER was not confirmed" in console.send("POWER", 400, state="off")["message"]
    row = console.end(console.send("SET_EXPOSURE", exposure_ms=77))
    assert (row["result"], row["user"], row["run_id"], row["needs_operator"]) == ("completed", "ann", None, False)
    assert console.request("POST", "/commands/check", user="bob", json={"name": "GET_STATUS"})["allowed"] is False
    abort = console.end(console.request("POST", "/commands/abort", 201, user="bob")["command"])
    assert (abort["result"], abort["user"]) == ("completed", "bob")


def test_an_unknown_command_is_resolved_by_retry_or_statement(console):
    """The stored command has the fields that the pages need to offer a retry or a statement."""
    console.sensor.deaf = True
    row = console.end(console.send("TAKE_IMAGE"))
    assert (row["result"], row["needs_operator"], row["can_retry"], row["idempotent"]) == ("unknown", True, True, False)
    console.request("POST", f"/commands/{row['id']}/withdraw", 409)
    console.sensor.deaf = False
    console.request("POST", f"/commands/{row['id']}/retry", 409, user="bob")
    console.request("POST", f"/commands/{row['id']}/retry")
    assert console.end(row)["attempts"] == 2
    console.request("POST", f"/commands/{row['id']}/resolve", 409, json={"note": "late"})


def test_simulator_commands_are_hidden_from_a_real_unit(make_console):
    """The dictionary of a real unit lists no simulator command, and a request for one is rejected."""
    console = make_console(simulated=False, serial="FM-1")
    assert not [c for c in console.request("GET", "/dictionary")["commands"] if c["simulator_only"]]
    assert "for simulators only" in console.send("SIM_INJECT", 409)["message"]


def test_history_pages_filters_and_exports(console):
    """The list and both exported files apply the same filter."""
    for exposure_ms in (11, 22, 33):
        console.end(console.send("SET_EXPOSURE", exposure_ms=exposure_ms))
    query = {"name": ["SET_EXPOSURE"], "user": "ann", "result": ["completed"]}
    rows = console.request("GET", "/commands", params=query)
    assert [r["arguments"]["exposure_ms"] for r in rows] == [33, 22, 11]
    page = console.request("GET", "/commands", params=query | {"limit": 1, "before": rows[0]["id"]})
    assert [r["id"] for r in page] == [rows[1]["id"]]
    assert [r["id"] for r in console.request("GET", "/commands", params={"text": "22"}) if r["user"] == "ann"] == [
        rows[1]["id"]
    ]
    span = {"start": rows[1]["created"], "end": rows[0]["created"]}
    assert rows[1]["id"] in [r["id"] for r in console.request("GET", "/commands", params=span)]
    exported = console.request("GET", "/commands.json", params=query)
    assert [r["id"] for r in exported] == [r["id"] for r in reversed(rows)]
    table = console.client.get("/api/commands.csv", params=query)
    assert table.headers["content-disposition"] == "attachment; filename=commands.csv"
    assert [int(r["id"]) for r in csv.DictReader(io.StringIO(table.text))] == [r["id"] for r in exported]
    assert "SET_EXPOSURE" in console.request("GET", "/commands/facets")["names"]
    created = rows[0]["created"]
    for path in ("/commands", "/commands.csv", "/commands.json"):
        assert (
            "span is empty" in console.request("GET", path, 400, params={"start": created, "end": created})["message"]
        )
    console.request("GET", "/commands", 422, params={"start": "yesterday"})


QUICK_LIST = """# Evening

## check-1: Check before GET_STATUS

```check
housekeeping.cycle_running == false
within: 10 s
```

## send-1: Send GET_STATUS

```command
GET_STATUS
```

## wait-2: Wait before POWER

```wait
1 s
```

## send-2: Send POWER

```command
POWER state=off
```
"""


def test_a_quick_list_is_stored_checked_run_and_followed(console):
    """A list of commands is stored and checked. After the confirmation of its hazardous command it runs to its end."""
    stored = console.request("POST", "/procedures", 201, json={"text": QUICK_LIST})
    check = console.request("POST", "/procedures/check", json={"text": QUICK_LIST})
    assert [step["confirm_name"] for step in check["steps"]] == ["", "", "", "POWER"]
    subscription = console.services.base.bus.subscribe(lambda: None)
    start = {"automatic": True, "confirm": ["POWER"]}
    run = console.request("POST", f"/procedures/{stored['id']}/start", 201, json=start)
    path = f"/procedure-runs/{run['id']}"
    console.request("POST", f"/procedures/{stored['id']}/start", 409, json=start)
    run = console.wait(lambda: next((r for r in [console.request("GET", path)] if r["finished"]), None))
    assert (run["state"], [entry["state"] for entry in run["entries"]]) == ("completed", ["done"] * 4)
    assert {m.topic for m in subscription.take()[0]} >= {"procedure_run", "command", "event"}
    sent = console.request("GET", "/commands", params={"run": run["id"]})
    assert [command["name"] for command in sent] == ["POWER", "GET_STATUS"]
    console.request("POST", f"{path}/pause", 409)
    console.request("POST", f"{path}/stop", 409, json={})


def test_a_command_is_scheduled_listed_and_cancelled(console):
    """The schedule shows times in UTC with the clock's uncertainty and describes each entry in text."""
    clock = console.wait(lambda: console.request("GET", "/schedule")["clock"])
    assert clock["uncertainty_s"] < 1
    at = (console.services.line.link._now() + timedelta(seconds=300)).isoformat()
    body = {"command": "SET_EXPOSURE", "arguments": {"exposure_ms": 44}, "at": at}
    check = console.request("POST", "/schedule/check", json=body)
    assert (check["problems"], check["hazard"]) == ([], "watch")
    assert bytes.fromhex(next(g["hex"] for g in check["bytes"] if g["label"] == "payload"))[:2] == b"\0\x2c"
    row = console.end(console.request("POST", "/schedule", 201, json=body))
    number = row["values"]["schedule_id"]

    def entry() -> Any:
        return next((e for e in console.request("GET", "/schedule")["entries"] if e["schedule_id"] == number), None)

    waiting_entry = console.wait(entry)
    assert (waiting_entry["command"], waiting_entry["text"], waiting_entry["state"]) == (
        "SET_EXPOSURE",
        "exposure 44",
        "waiting",
    )
    assert waiting_entry["at"][:16] == check["at"][:16]
    console.end(console.request("POST", f"/schedule/{number}/cancel", 201))
    console.wait(lambda: entry()["state"] == "cancelled")
    console.request("POST", f"/schedule/{number}/cancel", 409)
    console.request("POST", "/schedule/99/cancel", 404)
    assert "past" in console.request("POST", "/schedule", 400, json=body | {"at": "2020-01-01T00:00:00Z"})["message"]
    assert "immediately" in console.request("POST", "/schedule", 400, json={"command": "ABORT", "at": at})["message"]
    console.request("POST", "/schedule", 409, user="bob", json=body)
    console.request("POST", "/schedule", 422, json=body | {"at": "noon"})
    assert console.end(console.request("POST", "/schedule/refresh", 201))["name"] == "LIST_SCHEDULE"
    assert console.end(console.request("POST", "/schedule/cancel-all", 201))["result"] == "completed"

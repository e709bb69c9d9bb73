"""Alarms, limits, archive, contacts, record, replay and report over HTTP, on a contact with a sensor in memory."""

from __future__ import annotations

import csv
import io
import re
import time
from collections.abc import Iterator
from html.parser import HTMLParser
from typing import Any

import pyarrow.parquet as pq
import pytest
from fastapi.testclient import TestClient

from gss.settings import Settings
from gss.wiring.build import build

TEMPERATURE = "housekeeping.sensor_temperature_c"


class AlarmClient:
    """HTTP client of a server, with the sensor that the server is connected to."""

    def __init__(self, client: TestClient, sensor: Any) -> None:
        self.client, self.sensor = client, sensor

    def get(self, path: str, status: int = 200, **query: Any) -> Any:
        reply = self.client.get(f"/api{path}", params=query)
        assert reply.status_code == status, reply.text
        return reply.json()

    def send(self, method: str, path: str, body: Any = None, status: int = 200) -> Any:
        reply = self.client.request(method, f"/api{path}", **({} if body is None else {"json": body}))
        assert reply.status_code == status, reply.text
        return reply.json()

    def wait(self, condition: Any) -> Any:
        limit_s = time.monotonic() + 30
        while not (result := condition()):
            assert time.monotonic() < limit_s, self.get("/events")[-5:]
            time.sleep(0.02)
        return result

    def alarm(self, field: str) -> Any:
        """Return the open alarm of a field, or None."""
        return next((a for a in self.get("/alarms") if a["field"] == field), None)


@pytest.fixture
def console(sensor_in_memory, tmp_path, client_of) -> Iterator[AlarmClient]:
    """Client of a server in this process that is connected to a sensor in memory."""
    sensor = sensor_in_memory()
    sensor.PAUSE_S = 0.002  # five times real time: staleness uses the wall clock
    services = build(Settings(data=tmp_path / "data"))
    with client_of(services) as client:
        services.line.link.open_later(sensor.url)
        console = AlarmClient(client, sensor)
        console.wait(lambda: console.get("/link")["device"] != "no device")
        console.wait(lambda: next(v for v in console.get("/telemetry/latest")["values"])["state"] != "never")
        yield console


def test_an_operators_limit_raises_an_alarm_that_is_acknowledged_shelved_and_closed(console):
    """A violated limit of an operator raises an alarm. Each action changes its state; invalid actions are rejected."""
    before = console.get("/telemetry/limits")
    row = next(f for f in before["fields"] if f["key"] == TEMPERATURE)
    assert (before["set"], row["origin"], row["persistence"]) == ("nominal", "dictionary", 3)
    operator_limit = {"watch": [None, -60], "persistence": 1, "note": "test of the alarm"}
    changed = console.send("PUT", f"/telemetry/limits/{TEMPERATURE}", operator_limit)
    assert (changed["origin"], changed["watch"], changed["changed_by"]) == ("operator", [None, -60], "ann")
    alarm = console.wait(lambda: console.alarm("sensor_temperature_c"))
    assert (alarm["state"], alarm["level"], alarm["worst"], alarm["unit"]) == ("raised", "watch", "watch", "°C")
    assert alarm["limit_text"] == "above -60 (watch)"
    path = f"/alarms/{alarm['id']}"

    def alarm_in_header() -> bool:
        return f"alarm-{alarm['id']}" in [a["id"] for a in console.get("/link")["alarms"]]

    assert alarm_in_header()

    def fresh_value() -> Any:  # on a busy machine the newest value may be stale for a while
        values = console.get("/telemetry/latest")["values"]
        return next((v for v in values if v["alarm_id"] == alarm["id"] and v["state"] != "stale"), None)

    value = console.wait(fresh_value)
    assert (value["name"], value["state"], value["kind"]) == ("sensor_temperature_c", "watch", "number")
    assert re.fullmatch(r"0x[0-9A-F]{4}", value["raw_text"])
    assert int(value["raw_text"], 16) == value["raw"]
    console.send("POST", f"{path}/clear", {"note": "go away"}, 409)
    console.send("POST", f"{path}/shelve", {"minutes": 1441, "note": "x"}, 422)
    console.send("POST", f"{path}/shelve", {"minutes": 10, "note": ""}, 422)
    assert console.send("POST", f"{path}/shelve", {"minutes": 10, "note": "testing"})["shelved"]
    assert not alarm_in_header()
    assert not console.send("POST", f"{path}/unshelve", {})["shelved"]
    assert console.send("POST", f"{path}/acknowledge", {"note": "seen"})["state"] == "acked"
    console.send("POST", f"{path}/acknowledge", {}, 409)
    assert console.send("DELETE", f"/telemetry/limits/{TEMPERATURE}")["origin"] == "dictionary"
    console.wait(lambda: console.get(path)["state"] == "closed")
    assert console.alarm("sensor_temperature_c") is None
    assert alarm["id"] in [a["id"] for a in console.get("/alarms", open=False)]
    assert "testing" in console.get(path)["note"]
    kinds = [e["kind"] for e in console.get("/events", limit=1000)]
    assert kinds.count("limits") == 2
    assert kinds.count("alarm") >= 5
    console.get("/alarms/999999", 404)


def test_limit_sets_are_selected_and_invalid_limits_rejected(console):
    """A limit set changes the limits of the fields that it lists. Invalid input changes nothing."""
    after = console.send("PUT", "/telemetry/limits/set", {"name": "commissioning", "note": "bench"})
    row = next(f for f in after["fields"] if f["key"] == TEMPERATURE)
    assert (after["set"], row["origin"], row["watch"]) == ("commissioning", "set", [-25, 55])
    [shown] = [f for f in console.get("/dictionary")["telemetry"] if f"{f['packet']}.{f['name']}" == TEMPERATURE]
    assert shown["watch"] == [-25, 55]
    console.send("PUT", "/telemetry/limits/set", {"name": "party"}, 404)
    for key, body, status in (
        (TEMPERATURE, {"watch": [5, 4]}, 400),
        (TEMPERATURE, {"watch": [0, 20], "warning": [0, 10]}, 400),
        (TEMPERATURE, {"watch": [1]}, 422),
        (TEMPERATURE, {"watch": ["1", 2]}, 422),
        (TEMPERATURE, {"persistence": 0}, 422),
        ("housekeeping.mode", {"watch": [0, 1]}, 400),
        ("housekeeping.warp", {}, 404),
        ("warp", {}, 404),
    ):
        console.send("PUT", f"/telemetry/limits/{key}", body, status)
    assert console.get("/telemetry/limits") == after


def test_a_closed_contact_is_read_checked_exported_replayed_and_printed(console):
    """Every function of the Contacts page works on a closed contact, and invalid requests are rejected."""
    console.send("POST", "/commands", {"name": "GET_STATUS", "arguments": {}, "confirm": ""}, 201)
    console.wait(lambda: console.get("/contacts")[0]["rx_bytes"] > 3000)
    contact_id = console.get("/contacts")[0]["id"]
    console.send("POST", "/link/close")
    console.wait(lambda: console.get(f"/contacts/{contact_id}")["ended"])
    note = "<script>alert(1)</script> first light"
    detail = console.send("PUT", f"/contacts/{contact_id}/note", {"note": note})
    assert detail["note"] == note
    assert detail["counters"]["good"] > 10
    assert "GET_STATUS" in [c["name"] for c in detail["command_list"]]
    (capture,) = detail["captures"]
    data = console.client.get(f"/api/contacts/{contact_id}/captures/{capture['file']}").content
    assert len(data) == capture["bytes"] == detail["capture_bytes"]
    for name in ("contact-000099-000.raw", "..%2Fgss.db", "x"):
        assert console.client.get(f"/api/contacts/{contact_id}/captures/{name}").status_code == 404

    span = {"start": detail["started"], "end": detail["ended"]}
    packets = console.get("/telemetry/packets", packet="housekeeping", contact=contact_id, limit=1000)
    assert len(packets) == detail["packets"]["housekeeping"]
    keys = ["mode", "sensor_temperature_c", "housekeeping.uptime_s"]
    for form in ("converted", "raw", "formatted"):
        query = {"field": keys, **span, "form": form}
        csv_reply = console.client.get("/api/telemetry/export", params={**query, "format": "csv"})
        assert csv_reply.headers["content-type"].startswith("text/csv")
        rows = list(csv.DictReader(io.StringIO(csv_reply.text, newline="")))
        table = pq.read_table(
            io.BytesIO(console.client.get("/api/telemetry/export", params={**query, "format": "parquet"}).content)
        )
        assert len(rows) == table.num_rows == len(packets)
    assert rows[-1]["mode"] == packets[0]["values"]["mode"]
    history = console.get("/telemetry/history", name=keys, **span)
    assert [s["samples"] for s in history["series"]] == [len(packets)] * 3
    assert {c["name"] for c in history["series"][0]["choices"]} >= {"standby", "tracking"}
    console.get("/telemetry/history", 400, name="catalogue_sha256", **span)
    console.get("/telemetry/export", 404, field="warp", **span)

    record = console.get(f"/contacts/{contact_id}/record")
    assert record["held"] + sum(g["missing"] for g in record["gaps"]) == record["expected"]
    report = console.get(f"/contacts/{contact_id}/report")
    assert report["volumes"]["telemetry_packets"] == sum(detail["packets"].values())
    check_page(console.client.get(f"/api/contacts/{contact_id}/report.html").text)
    assert console.client.get(f"/api/contacts/{contact_id}/report.pdf").content.startswith(b"%PDF")

    started = console.send("POST", f"/contacts/{contact_id}/replay", {"speed": None}, 201)
    assert started["contact_id"] == contact_id
    ended = console.wait(lambda: (r := console.get("/replay")) and r["state"] == "ended" and r)
    assert (ended["share"], ended["packets"]) == (1.0, sum(detail["packets"].values()))
    assert len(console.get("/telemetry/packets", packet="housekeeping", contact=contact_id, limit=1000)) == len(packets)
    console.send("PUT", "/replay", {"speed": 10}, 409)
    console.send("POST", f"/contacts/{contact_id}/replay", {"speed": 0.01}, 422)
    console.send("POST", "/contacts/999/replay", {"speed": 1}, 404)
    console.send("POST", f"/contacts/{contact_id}/replay", {"speed": 0.1, "start": detail["started"]}, 201)
    assert console.send("PUT", "/replay", {"paused": True})["state"] == "paused"
    assert console.send("DELETE", "/replay")["reason"] == "stopped"
    for path in ("", "/record", "/report", "/report.html"):
        assert console.client.get(f"/api/contacts/999{path}").status_code == 404


class PageParser(HTMLParser):
    """Parser that collects the tags and addresses of a page."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.addresses: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.addresses += [value or "" for name, value in attrs if name in ("src", "href", "srcset", "action")]


def check_page(text: str) -> None:
    """Check that the page is self-contained, runs and loads nothing, and shows user text unchanged."""
    page = PageParser()
    page.feed(text)
    assert text.startswith("<!doctype html>")
    assert "script" not in page.tags
    assert page.addresses == []
    assert "&lt;script&gt;alert(1)&lt;/script&gt; first light" in text
    assert {"svg", "polyline", "table", "style"} <= set(page.tags)
    assert "@media print" in text
    for word in ("GET_STATUS", "Damaged packets", "housekeeping packets"):
        assert word in text

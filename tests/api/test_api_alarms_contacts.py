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
    """A client and the sensor behind it."""

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

    def wait(self, look: Any) -> Any:
        limit_s = time.monotonic() + 30
        while not (found := look()):
            assert time.monotonic() < limit_s, self.get("/events")[-5:]
            time.sleep(0.02)
        return found

    def alarm(self, field: str) -> Any:
        """Return the open alarm of a field, or None."""
        return next((a for a in self.get("/alarms") if a["field"] == field), None)


@pytest.fixture
def room(sensor_in_memory, tmp_path, client_of) -> Iterator[AlarmClient]:
    """A server in this process whose link leads to a sensor in memory."""
    sensor = sensor_in_memory()
    sensor.PAUSE_S = 0.002  # five times real time: staleness uses the wall clock
    services = build(Settings(data=tmp_path / "data"))
    with client_of(services) as client:
        services.line.link.open_later(sensor.url)
        room = AlarmClient(client, sensor)
        room.wait(lambda: room.get("/link")["device"] != "no device")
        room.wait(lambda: next(v for v in room.get("/telemetry/latest")["values"])["state"] != "never")
        yield room


def test_an_operators_limit_raises_an_alarm_that_is_acknowledged_shelved_and_closed(room):
    """From PUT limits to closed: states, header, the value's alarm id, notes, and rejected requests."""
    before = room.get("/telemetry/limits")
    row = next(f for f in before["fields"] if f["key"] == TEMPERATURE)
    assert (before["set"], row["origin"], row["persistence"]) == ("nominal", "dictionary", 3)
    own = {"watch": [None, -60], "persistence": 1, "note": "test of the alarm"}
    changed = room.send("PUT", f"/telemetry/limits/{TEMPERATURE}", own)
    assert (changed["origin"], changed["watch"], changed["changed_by"]) == ("operator", [None, -60], "ann")
    alarm = room.wait(lambda: room.alarm("sensor_temperature_c"))
    assert (alarm["state"], alarm["level"], alarm["worst"], alarm["unit"]) == ("raised", "watch", "watch", "°C")
    assert alarm["limit_text"] == "above -60 (watch)"
    path = f"/alarms/{alarm['id']}"

    def in_header() -> bool:
        return f"alarm-{alarm['id']}" in [a["id"] for a in room.get("/link")["alarms"]]

    assert in_header()

    def fresh_value() -> Any:  # on a busy machine the newest value may be stale for a while
        values = room.get("/telemetry/latest")["values"]
        return next((v for v in values if v["alarm_id"] == alarm["id"] and v["state"] != "stale"), None)

    value = room.wait(fresh_value)
    assert (value["name"], value["state"], value["kind"]) == ("sensor_temperature_c", "watch", "number")
    assert re.fullmatch(r"0x[0-9A-F]{4}", value["raw_text"])
    assert int(value["raw_text"], 16) == value["raw"]
    room.send("POST", f"{path}/clear", {"note": "go away"}, 409)
    room.send("POST", f"{path}/shelve", {"minutes": 1441, "note": "x"}, 422)
    room.send("POST", f"{path}/shelve", {"minutes": 10, "note": ""}, 422)
    assert room.send("POST", f"{path}/shelve", {"minutes": 10, "note": "testing"})["shelved"]
    assert not in_header()
    assert not room.send("POST", f"{path}/unshelve", {})["shelved"]
    assert room.send("POST", f"{path}/acknowledge", {"note": "seen"})["state"] == "acked"
    room.send("POST", f"{path}/acknowledge", {}, 409)
    assert room.send("DELETE", f"/telemetry/limits/{TEMPERATURE}")["origin"] == "dictionary"
    room.wait(lambda: room.get(path)["state"] == "closed")
    assert room.alarm("sensor_temperature_c") is None
    assert alarm["id"] in [a["id"] for a in room.get("/alarms", open=False)]
    assert "testing" in room.get(path)["note"]
    kinds = [e["kind"] for e in room.get("/events", limit=1000)]
    assert kinds.count("limits") == 2
    assert kinds.count("alarm") >= 5
    room.get("/alarms/999999", 404)


def test_limit_sets_are_selected_and_invalid_limits_rejected(room):
    """The set changes the limits of the fields that have a row for it; invalid input changes nothing."""
    after = room.send("PUT", "/telemetry/limits/set", {"name": "commissioning", "note": "bench"})
    row = next(f for f in after["fields"] if f["key"] == TEMPERATURE)
    assert (after["set"], row["origin"], row["watch"]) == ("commissioning", "set", [-25, 55])
    room.send("PUT", "/telemetry/limits/set", {"name": "party"}, 404)
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
        room.send("PUT", f"/telemetry/limits/{key}", body, status)
    assert room.get("/telemetry/limits") == after


def test_a_closed_contact_is_read_checked_exported_replayed_and_printed(room):
    """All functions of the Contacts page."""
    room.send("POST", "/commands", {"name": "GET_STATUS", "arguments": {}, "confirm": ""}, 201)
    room.wait(lambda: room.get("/contacts")[0]["rx_bytes"] > 3000)
    contact_id = room.get("/contacts")[0]["id"]
    room.send("POST", "/link/close")
    room.wait(lambda: room.get(f"/contacts/{contact_id}")["ended"])
    note = "<script>alert(1)</script> first light"
    detail = room.send("PUT", f"/contacts/{contact_id}/note", {"note": note})
    assert detail["note"] == note
    assert detail["counters"]["good"] > 10
    assert "GET_STATUS" in [c["name"] for c in detail["command_list"]]
    (capture,) = detail["captures"]
    data = room.client.get(f"/api/contacts/{contact_id}/captures/{capture['file']}").content
    assert len(data) == capture["bytes"] == detail["capture_bytes"]
    for name in ("contact-000099-000.raw", "..%2Fgss.db", "x"):
        assert room.client.get(f"/api/contacts/{contact_id}/captures/{name}").status_code == 404

    span = {"start": detail["started"], "end": detail["ended"]}
    packets = room.get("/telemetry/packets", packet="housekeeping", contact=contact_id, limit=1000)
    assert len(packets) == detail["packets"]["housekeeping"]
    keys = ["mode", "sensor_temperature_c", "housekeeping.uptime_s"]
    for form in ("converted", "raw", "formatted"):
        query = {"field": keys, **span, "form": form}
        text = room.client.get("/api/telemetry/export", params={**query, "format": "csv"})
        assert text.headers["content-type"].startswith("text/csv")
        rows = list(csv.DictReader(io.StringIO(text.text, newline="")))
        table = pq.read_table(
            io.BytesIO(room.client.get("/api/telemetry/export", params={**query, "format": "parquet"}).content)
        )
        assert len(rows) == table.num_rows == len(packets)
    assert rows[-1]["mode"] == packets[0]["values"]["mode"]
    history = room.get("/telemetry/history", name=keys, **span)
    assert [s["samples"] for s in history["series"]] == [len(packets)] * 3
    assert {c["name"] for c in history["series"][0]["choices"]} >= {"standby", "tracking"}
    room.get("/telemetry/history", 400, name="catalogue_sha256", **span)
    room.get("/telemetry/export", 404, field="warp", **span)

    record = room.get(f"/contacts/{contact_id}/record")
    assert record["held"] + sum(g["missing"] for g in record["gaps"]) == record["expected"]
    report = room.get(f"/contacts/{contact_id}/report")
    assert report["volumes"]["telemetry_packets"] == sum(detail["packets"].values())
    check_page(room.client.get(f"/api/contacts/{contact_id}/report.html").text)
    assert room.client.get(f"/api/contacts/{contact_id}/report.pdf").content.startswith(b"%PDF")

    started = room.send("POST", f"/contacts/{contact_id}/replay", {"speed": None}, 201)
    assert started["contact_id"] == contact_id
    ended = room.wait(lambda: (r := room.get("/replay")) and r["state"] == "ended" and r)
    assert (ended["share"], ended["packets"]) == (1.0, sum(detail["packets"].values()))
    assert len(room.get("/telemetry/packets", packet="housekeeping", contact=contact_id, limit=1000)) == len(packets)
    room.send("PUT", "/replay", {"speed": 10}, 409)
    room.send("POST", f"/contacts/{contact_id}/replay", {"speed": 0.01}, 422)
    room.send("POST", "/contacts/999/replay", {"speed": 1}, 404)
    room.send("POST", f"/contacts/{contact_id}/replay", {"speed": 0.1, "start": detail["started"]}, 201)
    assert room.send("PUT", "/replay", {"paused": True})["state"] == "paused"
    assert room.send("DELETE", "/replay")["reason"] == "stopped"
    for path in ("", "/record", "/report", "/report.html"):
        assert room.client.get(f"/api/contacts/999{path}").status_code == 404


class Page(HTMLParser):
    """Tags and addresses of a page."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.addresses: list[str] = []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.addresses += [value or "" for name, value in attrs if name in ("src", "href", "srcset", "action")]


def check_page(text: str) -> None:
    """Check that the page is self-contained, runs and loads nothing, and shows user text unchanged."""
    page = Page()
    page.feed(text)
    assert text.startswith("<!doctype html>")
    assert "script" not in page.tags
    assert page.addresses == []
    assert "&lt;script&gt;alert(1)&lt;/script&gt; first light" in text
    assert {"svg", "polyline", "table", "style"} <= set(page.tags)
    assert "@media print" in text
    for word in ("GET_STATUS", "Damaged packets", "housekeeping packets"):
        assert word in text

"""Orbit, ground stations and passes over HTTP: imported, judged, predicted, exported, audited; and bad input."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from datetime import datetime
from pathlib import Path

import pytest
from fastapi.testclient import TestClient

from gss.settings import Settings
from gss.wiring.build import build

TleOf = Callable[[float], str]
STATION = {
    "name": "Stellenbosch",
    "latitude_deg": -33.9275,
    "longitude_deg": 18.865,
    "height_m": 136.0,
    "min_elevation_deg": 5.0,
    "line_baud": 115_200,
}


@pytest.fixture
def fresh(tmp_path: Path, client_of: Callable[..., TestClient]) -> Iterator[TestClient]:
    """A server without orbit and stations."""
    with client_of(build(Settings(data=tmp_path))) as client:
        yield client


def test_without_orbit_or_station_the_table_says_what_to_do(fresh: TestClient, tle_of: TleOf) -> None:
    """Nothing is assumed; each missing part is named."""
    empty = fresh.get("/api/passes").json()
    assert (empty["passes"], empty["problem"]) == ([], "No orbit was imported.")
    assert empty["spacecraft"]["state"] == "never"
    assert fresh.put("/api/spacecraft", json={"text": tle_of(0)}).status_code == 200
    assert fresh.get("/api/passes").json()["problem"] == "There is no ground station."
    assert fresh.get("/api/spacecraft/omm.json").json()["OBJECT_NAME"] == "ZA-1"


def test_passes_of_three_days_are_in_order_and_consistent(fresh: TestClient, tle_of: TleOf) -> None:
    """Rise before culmination before set, above the minimum elevation; the budget is the line's rate; overlaps are
    named."""
    reply = fresh.put("/api/spacecraft", json={"text": tle_of(1), "source": "tracking service"}).json()
    assert (reply["name"], reply["state"], reply["plannable"]) == ("ZA-1", "ok", True)
    assert reply["orbit"]["source"] == "tracking service"
    assert fresh.post("/api/stations", json=STATION).status_code == 201
    hill = [{"azimuth_deg": 0.0, "elevation_deg": 4.0}, {"azimuth_deg": 90.0, "elevation_deg": 12.0}]
    near = STATION | {"name": "Cape Town", "longitude_deg": 18.42, "mask": hill}
    made = fresh.post("/api/stations", json=near).json()
    assert made["mask"] == hill
    table = fresh.get("/api/passes?days=3").json()
    assert len(table["passes"]) >= 12
    assert table["warnings"] == ["No horizon mask is set for Stellenbosch: the horizon is assumed to be flat."]
    rises = [p["rise"] for p in table["passes"]]
    assert rises == sorted(rises)
    for one in table["passes"]:
        assert one["rise"] <= one["culmination"] <= one["set"]
        assert one["max_elevation_deg"] == max(t["elevation_deg"] for t in one["track"]) >= 5.0
        assert one["content_bytes"] == int(11_520 * 0.8 * one["duration_s"])
        assert one["downloads"] == 0
    assert any(p["overlaps"] for p in table["passes"])
    only = fresh.get(f"/api/passes?days=3&station={made['id']}").json()
    assert {p["station"] for p in only["passes"]} == {"Cape Town"}


def test_the_calendar_and_the_ephemeris_can_be_read_by_others(fresh: TestClient, tle_of: TleOf) -> None:
    """One event for each pass with lines of at most 75 bytes; the exported OEM, imported again, gives the same
    passes."""
    fresh.put("/api/spacecraft", json={"text": tle_of(0)})
    fresh.post("/api/stations", json=STATION | {"name": "Cape Town; north, \\ ä" + "ö" * 30})
    passes = fresh.get("/api/passes?days=2").json()["passes"]
    calendar = fresh.get("/api/passes/calendar.ics?days=2")
    assert calendar.headers["content-type"].startswith("text/calendar")
    lines = calendar.text.split("\r\n")
    assert lines[0], lines[-2] == ("BEGIN:VCALENDAR", "END:VCALENDAR")
    assert all(len(line.encode()) <= 75 for line in lines)
    assert len([line for line in lines if line == "BEGIN:VEVENT"]) in (len(passes), len(passes) - 1)
    assert "LOCATION:Cape Town\\; north\\, \\\\ ä" in calendar.text
    starts = re.findall(r"DTSTART:(\d{8}T\d{6}Z)", calendar.text)
    assert starts[-1] == re.sub(r"[-:]|\.\d+", "", passes[-1]["rise"])
    oem = fresh.get("/api/spacecraft/orbit.oem?days=2").text
    reply = fresh.put("/api/spacecraft", json={"text": oem}).json()
    assert (reply["orbit"]["kind"], reply["name"]) == ("oem", "ZA-1")
    again = fresh.get("/api/passes?days=1.8").json()["passes"]
    for old, new in zip(passes[1:], again[1:], strict=False):
        moments = (datetime.fromisoformat(old["rise"]), datetime.fromisoformat(new["rise"]))
        assert abs((moments[0] - moments[1]).total_seconds()) < 0.1
    assert fresh.get("/api/spacecraft/omm.json").status_code == 409


@pytest.mark.parametrize(("age", "state"), [(1, "ok"), (5, "watch"), (10, "warning"), (20, "critical"), (-5, "watch")])
def test_old_elements_are_marked_with_their_age(fresh: TestClient, tle_of: TleOf, age: float, state: str) -> None:
    """State and advice name the age; beyond two weeks no plan may rely on them."""
    reply = fresh.put("/api/spacecraft", json={"text": tle_of(age)}).json()
    assert (reply["state"], reply["plannable"]) == (state, state != "critical")
    assert reply["age_days"] == pytest.approx(age, abs=0.01)
    assert f"{abs(age)}.0 days" in reply["advice"]
    fresh.post("/api/stations", json=STATION)
    table = fresh.get("/api/passes?days=1").json()
    assert (reply["advice"] in table["warnings"]) == (state != "ok")


def test_bad_orbits_change_nothing(fresh: TestClient, tle_of: TleOf) -> None:
    """A wrong checksum and elements of years ago are rejected with the reason; the orbit before stays in use."""
    fresh.put("/api/spacecraft", json={"text": tle_of(0)})
    good = tle_of(0).rstrip()
    wrong = good[:-1] + str((int(good[-1]) + 1) % 10)
    reply = fresh.put("/api/spacecraft", json={"text": wrong})
    assert (reply.status_code, "wrong checksum" in reply.json()["message"]) == (400, True)
    old = fresh.put("/api/spacecraft", json={"text": tle_of(90)})
    assert (old.status_code, old.json()["message"]) == (400, "The orbit is too old.")
    assert len(fresh.get("/api/spacecraft").json()["history"]) == 1


def test_stations_are_changed_and_deleted_with_a_record(fresh: TestClient) -> None:
    """Names are unique; each change is in the audit log with what changed."""
    made = fresh.post("/api/stations", json=STATION).json()
    assert fresh.post("/api/stations", json=STATION).status_code == 409
    moved = fresh.put(f"/api/stations/{made['id']}", json=STATION | {"height_m": 200.0}).json()
    assert (moved["height_m"], moved["latitude_deg"]) == (200.0, STATION["latitude_deg"])
    assert fresh.put(f"/api/stations/{made['id']}", json=STATION | {"line_url": "nonsense://x"}).status_code == 400
    assert fresh.post("/api/stations", json=STATION | {"name": " "}).status_code == 400
    twice = [{"azimuth_deg": 10.0, "elevation_deg": 4.0}] * 2
    reply = fresh.post("/api/stations", json=STATION | {"name": "x", "mask": twice})
    assert (reply.status_code, "do not increase" in reply.json()["message"]) == (400, True)
    assert fresh.delete(f"/api/stations/{made['id']}").status_code == 204
    assert fresh.get("/api/stations").json() == []
    log = [row["detail"] for row in fresh.get("/api/audit?limit=20").json()]
    assert any("136 m" in text and "to Stellenbosch" in text and "200 m" in text for text in log)


def test_a_plan_is_made_checked_and_deleted(fresh: TestClient, tle_of: TleOf) -> None:
    """Items get their titles; what cannot work is rejected with the reason; nothing is armed that does not fit."""
    fresh.put("/api/spacecraft", json={"text": tle_of(0)})
    station = fresh.post("/api/stations", json=STATION).json()["id"]
    one = fresh.get("/api/passes?days=3").json()["passes"][1]
    item = {"kind": "download", "content": "frame", "slot": 0, "estimated_s": 60.0}
    body = {"name": "first", "station_id": station, "at": one["culmination"], "items": [item]}
    plan = fresh.post("/api/pass-plans", json=body).json()
    assert (plan["state"], plan["items"][0]["title"]) == ("draft", "Download frame of slot 0")
    assert (plan["problems"], plan["confirm"], plan["planned_s"]) == ([], [], 60.0)
    late = datetime.fromisoformat(one["set"]).timestamp() + 1200
    away = body | {"at": datetime.fromtimestamp(late).astimezone().isoformat()}
    assert "not in view" in fresh.post("/api/pass-plans", json=away).json()["message"]
    for wrong in (
        item | {"slot": None},
        item | {"kind": "upload"},
        item | {"kind": "stack", "stack_id": 77},
        item | {"estimated_s": 0.0},
    ):
        assert fresh.post("/api/pass-plans", json=body | {"items": [wrong]}).status_code in (400, 404, 422)
    long = fresh.post("/api/pass-plans", json=body | {"items": [item | {"estimated_s": 5000.0}]}).json()
    assert "Remove items" in long["problems"][0]
    reply = fresh.post(f"/api/pass-plans/{long['id']}/arm", json={})
    assert (reply.status_code, "cannot be armed" in reply.json()["message"]) == (409, True)
    armed = fresh.post(f"/api/pass-plans/{plan['id']}/arm", json={}).json()
    assert (armed["state"], armed["armed_by"]) == ("armed", "ann")
    assert [p["id"] for p in fresh.get("/api/pass-plans/active").json()] == [plan["id"]]
    assert fresh.delete(f"/api/pass-plans/{plan['id']}").status_code == 409
    assert fresh.post(f"/api/pass-plans/{plan['id']}/stop").json()["state"] == "stopped"
    assert fresh.delete(f"/api/pass-plans/{long['id']}").status_code == 204
    assert [p["id"] for p in fresh.get("/api/pass-plans").json()] == [plan["id"]]

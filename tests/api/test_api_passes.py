"""Orbit, ground stations, passes and pass plans over HTTP, with exports, audit and invalid input."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest
from fastapi.testclient import TestClient

from gss.settings import Settings
from gss.store.models import Catalogue
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
def http(tmp_path: Path, client_of: Callable[..., TestClient]) -> Iterator[TestClient]:
    """Client of a server without orbit and stations."""
    with client_of(build(Settings(data=tmp_path))) as client:
        yield client


def test_without_orbit_or_station_the_table_says_what_to_do(http: TestClient, tle_of: TleOf) -> None:
    """The table names each missing part and lists no passes without it."""
    empty = http.get("/api/passes").json()
    assert (empty["passes"], empty["problem"]) == ([], "No orbit was imported.")
    assert empty["spacecraft"]["state"] == "never"
    assert http.put("/api/spacecraft", json={"text": tle_of(0)}).status_code == 200
    assert http.get("/api/passes").json()["problem"] == "There is no ground station."
    assert http.get("/api/spacecraft/omm.json").json()["OBJECT_NAME"] == "ZA-1"


def test_passes_of_three_days_are_in_order_and_consistent(http: TestClient, tle_of: TleOf) -> None:
    """Passes are ordered by rise time and above the minimum elevation. The data budget follows the rate of the line.
    Overlaps are named."""
    reply = http.put("/api/spacecraft", json={"text": tle_of(1), "source": "tracking service"}).json()
    assert (reply["name"], reply["state"], reply["plannable"]) == ("ZA-1", "ok", True)
    assert reply["orbit"]["source"] == "tracking service"
    assert http.post("/api/stations", json=STATION).status_code == 201
    hill = [{"azimuth_deg": 0.0, "elevation_deg": 4.0}, {"azimuth_deg": 90.0, "elevation_deg": 12.0}]
    second_station = STATION | {"name": "Cape Town", "longitude_deg": 18.42, "mask": hill}
    station = http.post("/api/stations", json=second_station).json()
    assert station["mask"] == hill
    table = http.get("/api/passes?days=3").json()
    assert len(table["passes"]) >= 12
    assert table["warnings"] == ["No horizon mask is set for Stellenbosch: the horizon is assumed to be flat."]
    rises = [p["rise"] for p in table["passes"]]
    assert rises == sorted(rises)
    for pass_ in table["passes"]:
        assert pass_["rise"] <= pass_["culmination"] <= pass_["set"]
        assert pass_["max_elevation_deg"] == max(t["elevation_deg"] for t in pass_["track"]) >= 5.0
        assert pass_["content_bytes"] == int(11_520 * 0.8 * pass_["duration_s"])
        assert pass_["downloads"] == 0
    assert any(p["overlaps"] for p in table["passes"])
    one_station = http.get(f"/api/passes?days=3&station={station['id']}").json()
    assert {p["station"] for p in one_station["passes"]} == {"Cape Town"}


def test_the_calendar_and_the_ephemeris_can_be_read_by_others(http: TestClient, tle_of: TleOf) -> None:
    """The calendar has an event for each pass and lines of at most 75 bytes. The exported OEM, imported again, gives
    the same passes.
    """
    http.put("/api/spacecraft", json={"text": tle_of(0)})
    http.post("/api/stations", json=STATION | {"name": "Cape Town; north, \\ ä" + "ö" * 30})
    passes = http.get("/api/passes?days=2").json()["passes"]
    calendar = http.get("/api/passes/calendar.ics?days=2")
    assert calendar.headers["content-type"].startswith("text/calendar")
    lines = calendar.text.split("\r\n")
    assert (lines[0], lines[-2]) == ("BEGIN:VCALENDAR", "END:VCALENDAR")
    assert all(len(line.encode()) <= 75 for line in lines)
    assert len([line for line in lines if line == "BEGIN:VEVENT"]) in (len(passes), len(passes) - 1)
    assert "LOCATION:Cape Town\\; north\\, \\\\ ä" in calendar.text
    starts = re.findall(r"DTSTART:(\d{8}T\d{6}Z)", calendar.text)
    assert starts[-1] == re.sub(r"[-:]|\.\d+", "", passes[-1]["rise"])
    oem = http.get("/api/spacecraft/orbit.oem?days=2").text
    reply = http.put("/api/spacecraft", json={"text": oem}).json()
    assert (reply["orbit"]["kind"], reply["name"]) == ("oem", "ZA-1")
    again = http.get("/api/passes?days=1.8").json()["passes"]
    for old, new in zip(passes[1:], again[1:], strict=False):
        moments = (datetime.fromisoformat(old["rise"]), datetime.fromisoformat(new["rise"]))
        assert abs((moments[0] - moments[1]).total_seconds()) < 0.1
    assert http.get("/api/spacecraft/omm.json").status_code == 409


@pytest.mark.parametrize(("age", "state"), [(1, "ok"), (5, "watch"), (10, "warning"), (20, "critical"), (-5, "watch")])
def test_old_elements_are_marked_with_their_age(http: TestClient, tle_of: TleOf, age: float, state: str) -> None:
    """State and advice follow the age of the elements. Elements older than two weeks cannot be used for plans."""
    reply = http.put("/api/spacecraft", json={"text": tle_of(age)}).json()
    assert (reply["state"], reply["plannable"]) == (state, state != "critical")
    assert reply["age_days"] == pytest.approx(age, abs=0.01)
    assert f"{abs(age)}.0 days" in reply["advice"]
    http.post("/api/stations", json=STATION)
    table = http.get("/api/passes?days=1").json()
    assert (reply["advice"] in table["warnings"]) == (state != "ok")


def test_bad_orbits_change_nothing(http: TestClient, tle_of: TleOf) -> None:
    """Elements with a wrong checksum and elements that are too old are rejected with the reason. The previous orbit
    stays.
    """
    http.put("/api/spacecraft", json={"text": tle_of(0)})
    good = tle_of(0).rstrip()
    wrong = good[:-1] + str((int(good[-1]) + 1) % 10)
    reply = http.put("/api/spacecraft", json={"text": wrong})
    assert (reply.status_code, "wrong checksum" in reply.json()["message"]) == (400, True)
    old = http.put("/api/spacecraft", json={"text": tle_of(90)})
    assert (old.status_code, old.json()["message"]) == (400, "The orbit is too old.")
    assert len(http.get("/api/spacecraft").json()["history"]) == 1


def test_stations_are_changed_and_deleted_with_a_record(http: TestClient) -> None:
    """Station names are unique. The audit log records the old and the new values of a change."""
    station = http.post("/api/stations", json=STATION).json()
    assert http.post("/api/stations", json=STATION).status_code == 409
    moved = http.put(f"/api/stations/{station['id']}", json=STATION | {"height_m": 200.0}).json()
    assert (moved["height_m"], moved["latitude_deg"]) == (200.0, STATION["latitude_deg"])
    assert http.put(f"/api/stations/{station['id']}", json=STATION | {"line_url": "nonsense://x"}).status_code == 400
    assert http.post("/api/stations", json=STATION | {"name": " "}).status_code == 400
    twice = [{"azimuth_deg": 10.0, "elevation_deg": 4.0}] * 2
    reply = http.post("/api/stations", json=STATION | {"name": "x", "mask": twice})
    assert (reply.status_code, "do not increase" in reply.json()["message"]) == (400, True)
    assert http.delete(f"/api/stations/{station['id']}").status_code == 204
    assert http.get("/api/stations").json() == []
    log = [row["detail"] for row in http.get("/api/audit?limit=20").json()]
    assert any("136 m" in text and "to Stellenbosch" in text and "200 m" in text for text in log)


def test_a_plan_is_made_checked_and_deleted(http: TestClient, tle_of: TleOf) -> None:
    """Items have titles. Impossible plans are rejected with the reason, and a plan that is too long cannot be armed."""
    http.put("/api/spacecraft", json={"text": tle_of(0)})
    station = http.post("/api/stations", json=STATION).json()["id"]
    passes = http.get("/api/passes?days=3").json()["passes"]
    pass_ = next(p for p in passes[1:] if p["duration_s"] > 300)
    item = {"kind": "download", "content": "frame", "slot": 0, "estimated_s": 60.0}
    body = {"name": "first", "station_id": station, "at": pass_["culmination"], "items": [item]}
    plan = http.post("/api/pass-plans", json=body).json()
    assert (plan["state"], plan["items"][0]["title"]) == ("draft", "Download frame of slot 0")
    assert (plan["problems"], plan["confirm"], plan["planned_s"]) == ([], [], 60.0)
    late = datetime.fromisoformat(pass_["set"]).timestamp() + 1200
    out_of_view = body | {"at": datetime.fromtimestamp(late).astimezone().isoformat()}
    assert "not in view" in http.post("/api/pass-plans", json=out_of_view).json()["message"]
    for wrong in (
        item | {"slot": None},
        item | {"kind": "upload"},
        item | {"kind": "procedure", "procedure_id": 77},
        item | {"estimated_s": 0.0},
    ):
        assert http.post("/api/pass-plans", json=body | {"items": [wrong]}).status_code in (400, 404, 422)
    long = http.post("/api/pass-plans", json=body | {"items": [item | {"estimated_s": 5000.0}]}).json()
    assert "Remove items" in long["problems"][0]
    reply = http.post(f"/api/pass-plans/{long['id']}/arm", json={})
    assert (reply.status_code, "cannot be armed" in reply.json()["message"]) == (409, True)
    armed = http.post(f"/api/pass-plans/{plan['id']}/arm", json={}).json()
    assert (armed["state"], armed["armed_by"]) == ("armed", "ann")
    assert [p["id"] for p in http.get("/api/pass-plans/active").json()] == [plan["id"]]
    assert http.delete(f"/api/pass-plans/{plan['id']}").status_code == 409
    assert http.post(f"/api/pass-plans/{plan['id']}/stop").json()["state"] == "stopped"
    assert http.delete(f"/api/pass-plans/{long['id']}").status_code == 204
    assert [p["id"] for p in http.get("/api/pass-plans").json()] == [plan["id"]]


def test_a_catalogue_is_compared_with_the_imported_orbit(http: TestClient, tle_of: TleOf) -> None:
    """A catalogue for the orbit is left after its days of use; the orbit of another plane is outside; a catalogue of the
    whole sky does not depend on the orbit."""

    def built(**changes: object) -> int:
        reply = http.post("/api/catalogues", json={"profile": "cubestar", "faint_mag": 2.2, **changes})
        assert reply.status_code == 202, reply.text
        while (job := http.get(f"/api/jobs/{reply.json()['id']}").json())["state"] in ("queued", "running"):
            time.sleep(0.05)
        assert job["state"] == "done", job["text"]
        return int(job["result"]["catalogue_id"])

    def compared(catalogue_id: int) -> dict[str, str]:
        return dict(http.get(f"/api/catalogues/{catalogue_id}/orbit").json())

    bound, free = built(orbit="tle", tle=tle_of(1), days=30), built()
    assert compared(free)["state"] == "independent"
    assert compared(bound)["text"] == "Not compared with the orbit: no orbit was imported."
    http.put("/api/spacecraft", json={"text": tle_of(1)})
    inside = compared(bound)
    assert inside["state"] == "inside"
    assert 29 < (datetime.fromisoformat(inside["leaves"]) - datetime.now(UTC)) / timedelta(days=1) < 33
    assert "leaves the envelope on" in inside["text"]
    other = built(orbit="elements", inclination_deg=97.6, raan_deg=[10, 20], days=30)
    outside = compared(other)
    assert (outside["state"], outside["leaves"]) == ("outside", None)
    assert "outside the envelope. Build a catalogue for this orbit." in outside["text"]
    with http.app.state.services.base.database.unit_of_work() as session:  # type: ignore[attr-defined]
        session.get(Catalogue, free).request = {}
    assert compared(free)["text"].startswith("Not compared with the orbit: it was read back from the unit")
    assert http.get("/api/catalogues/999/orbit").status_code == 404

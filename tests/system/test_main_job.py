"""The main job of the system with real processes over HTTP."""

from __future__ import annotations

import pytest

from gss.catalogue_tools.onboard import decode

pytestmark = pytest.mark.timeout(240)


@pytest.fixture
def console(serve):
    """A server with a simulated sensor that has identified itself and reported its banks."""
    server = serve("--simulator", "cubestar")
    console = server.console
    console.wait("the sensor's banks", lambda: (console.get("/link")["active_bank"] or {}).get("catalogue_id"), 60)
    return console


def test_operator_takes_an_image_and_the_ground_agrees_with_the_sensor(console):
    """Commands lead to an attitude. The frame is downlinked, stored, solved, compared and replayed with equal
    results.
    """
    link = console.get("/link")
    assert (link["simulated"], link["profile"], link["dictionary_match"]) == (True, "cubestar", True)
    assert [a for a in link["alarms"] if a["level"] in ("warning", "critical")] == []

    taken = console.command("TAKE_IMAGE")
    assert taken["result"] == "completed"
    assert [s["state"] for s in taken["stages"]] == ["passed"] * 5 + ["skipped", "passed"]
    for step in ("FIND_CENTROIDS", "MATCH_STARS", "CALCULATE_ATTITUDE"):
        assert console.command(step)["result"] == "completed"

    def compared():
        frame = console.get("/frames")["frames"]
        detail = console.get(f"/frames/{frame[0]['id']}") if frame else {}
        ready = detail.get("comparison") and detail["on_board"]["replay"]
        return detail if ready else None

    detail = console.wait("comparison and replay", compared)
    assert detail["number"] == taken["values"]["frame_number"]
    assert detail["comparison"]["agree"], detail["comparison"]
    assert detail["comparison"]["cross_arcsec"] < 60
    assert detail["on_board"]["replay"] == "equal"
    replay = console.get(f"/frames/{detail['id']}/replay")
    assert replay["text"] == "equal"
    verdicts = {s["name"]: s["verdict"] for s in replay["stages"]}
    assert {name for name, verdict in verdicts.items() if verdict != "equal"} == {"unit vectors"}
    assert {"bank", "places", "matches", "weights", "quaternion"} <= set(verdicts)
    assert {s["verdict"] for s in detail["solutions"]} <= {"correct", "imprecise"}
    assert detail["ground"]["error_axis_arcsec"] < 20
    names = {s["name"] for s in detail["ground"]["stars"] if s["hip"]}
    on_board_names = {s["name"] for s in detail["on_board"]["stars"] if s["hip"]}
    assert len(on_board_names & names) >= 5
    assert console.http.get(f"/frames/{detail['id']}/raw").headers["x-columns"] == "1024"
    assert len(console.http.get(f"/frames/{detail['id']}/recording.rrd").content) > 50_000


def test_manager_builds_a_catalogue_and_the_sensor_matches_with_it(console):
    """A catalogue is built, uploaded, verified, activated with its typed name and confirmed. The sensor solves
    with it.
    """
    hint = console.command("TAKE_IMAGE")
    assert hint["result"] == "completed"
    request = {"name": "all-sky-36", "faint_mag": 3.6, "profile": "cubestar", "format": "cubestar"}
    job = console.post("/catalogues", request, status=202)
    done = console.wait(
        "the build", lambda: next((j for j in [console.get(f"/jobs/{job['id']}")] if j["state"] == "done"), None)
    )
    catalogue = console.get(f"/catalogues/{done['result']['catalogue_id']}")
    image = console.http.get(f"/catalogues/{catalogue['id']}/image.bin").content
    assert len(decode(image)) == catalogue["stars"]

    transfer = console.post(f"/catalogues/{catalogue['id']}/upload", {"bank": "B"})
    ended = ("committed", "failed", "aborted")
    sent = console.wait(
        "the upload",
        lambda: next((t for t in [console.get(f"/transfers/{transfer['id']}")] if t["state"] in ended), None),
    )
    assert (sent["state"], sent["stored_bytes"], sent["sha256"]) == ("committed", len(image), catalogue["sha256"])

    refused = console.http.post("/commands", json={"name": "ACTIVATE_BANK", "arguments": {"bank": "B"}})
    assert (refused.status_code, "ACTIVATE_BANK typed" in refused.json()["expected"]) == (400, True)
    assert console.command("ACTIVATE_BANK", bank="B", confirm="ACTIVATE_BANK")["result"] == "completed"
    assert console.command("CONFIRM_BANK", bank="B")["result"] == "completed"
    active = console.wait(
        "bank B in the header",
        lambda: next((b for b in [console.get("/link")["active_bank"]] if b and b["bank"] == "B"), None),
    )
    assert active["catalogue_name"] == "all-sky-36"

    assert console.command("RUN_ITERATION")["values"]["outcome"] == "solved"

    def replayed():
        detail = console.get("/frames/latest")
        return detail if detail["on_board"] and detail["on_board"]["replay"] else None

    detail = console.wait("the replay from the new bank", replayed)
    assert detail["on_board"]["replay"] == "equal"
    assert console.get(f"/frames/{detail['id']}/replay")["text"] == "equal", "again, from what was stored"
    assert all(s["v_mag"] <= 3.6 for s in detail["on_board"]["stars"] if s["hip"])


def test_cycle_runs_and_telemetry_is_stored(console):
    """The sensor sends telemetry during its cycle, and the server returns history and cycle timing."""
    started = console.command("START_CYCLE")
    assert started["result"] == "completed"
    console.wait("three iterations", lambda: len(console.get("/telemetry/cycles", limit=5)) >= 3)
    console.command("STOP_CYCLE")
    latest = {v["name"]: v for v in console.get("/telemetry/latest")["values"] if v["packet"] == "housekeeping"}
    assert latest["mode"]["state"] == "ok"
    utc = console.get("/link")["utc"]
    history = console.get(
        "/telemetry/history", name=["supply_3v3_v", "iteration"], start="2020-01-01T00:00:00Z", end=utc, points=100
    )
    supply, iteration = history["series"]
    assert len(supply["t"]) >= 3
    assert all(3.0 < y < 3.6 for y in supply["y"])
    assert iteration["y"] == sorted(iteration["y"])

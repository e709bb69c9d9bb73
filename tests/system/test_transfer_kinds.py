"""Every kind of transfer through a real server and a real simulator."""

from __future__ import annotations

import numpy as np
import pytest

pytestmark = pytest.mark.timeout(240)


def online(console):
    return console.wait("the sensor", lambda: (console.get("/link")["active_bank"] or {}).get("catalogue_id"), 60)


def wait_for_state(console, transfer, *states: str):
    """Wait until the transfer has one of these states and return it."""

    def look():
        row = console.get(f"/transfers/{transfer['id']}")
        assert row["state"] not in {"failed", "aborted"} - set(states), row["reason"]
        return row if row["state"] in states else None

    return console.wait(f"{transfer['subject']} to be {states[0]}", look, 60)


def download(console, **what):
    return wait_for_state(console, console.post("/transfers/download", what), "verified")


def pixels(console, frame_id: int):
    reply = console.http.get(f"/frames/{frame_id}/raw")
    shape = int(reply.headers["X-Rows"]), int(reply.headers["X-Columns"])
    return np.frombuffer(reply.content, np.dtype(reply.headers["X-Dtype"])).reshape(shape)


def received_bytes(console) -> int:
    return console.get("/link/counters")["received"]["bytes"]


def test_a_stored_image_does_not_cross_the_line_again(serve):
    """A request for an image that was downloaded automatically returns the same frame without another download. A new
    image in the slot is downloaded. Without the automatic download, an image is downloaded only on request.
    """
    console = serve("--simulator", "cubestar").console
    online(console)
    console.command("TAKE_IMAGE", slot=1)
    whole = console.wait("the frame", lambda: [f for f in console.get("/frames")["frames"] if f["complete"]])[0]
    before = received_bytes(console)
    row = download(console, kind="frame", slot=1)
    assert (row["frame_id"], row["stored_bytes"], row["size"]) == (whole["id"], row["size"], 1024 * 512)
    assert received_bytes(console) - before < 100_000
    assert console.get("/frames")["total"] == 1


def test_without_the_automatic_download_an_image_comes_on_request(serve, monkeypatch):
    """With GSS_AUTO_DOWNLOAD=false a new image is listed without its pixels. A request downloads it, and also the next
    image of the slot."""
    monkeypatch.setenv("GSS_AUTO_DOWNLOAD", "false")
    console = serve("--simulator", "cubestar").console
    online(console)
    frames = []
    for number in (1, 2):
        console.command("TAKE_IMAGE", slot=2)
        row = download(console, kind="frame", slot=2)
        assert "started over" not in " ".join(row["log"])
        frames.append(row["frame_id"])
        assert console.get("/frames")["total"] == number
    assert frames[0] != frames[1]


def test_parts_of_an_image_come_down_at_their_places(serve):
    """Regions and star windows are frames of the full size that are zero outside the received rectangles."""
    console = serve("--simulator", "cubestar").console
    online(console)
    console.command("SET_MODE", mode="lost_in_space")
    console.command("RUN_ITERATION")
    whole = console.wait("the frame", lambda: [f for f in console.get("/frames")["frames"] if f["complete"]])[0]
    image = pixels(console, whole["id"])

    box = {"col_px": 101, "row_px": 37, "columns": 64, "rows": 50}
    row = download(console, kind="region", slot=whole["slot"], region=box)
    frame = console.get(f"/frames/{row['frame_id']}")
    assert (row["size"], row["options"]["region"]) == (64 * 50, box)
    assert (frame["part"], frame["held"], frame["rows_held"]) == ("region", [[101, 37, 64, 50]], [[37, 86]])
    assert (frame["columns"], frame["rows"], frame["complete"]) == (image.shape[1], image.shape[0], False)
    received = pixels(console, frame["id"])
    assert np.array_equal(received[37:87, 101:165], image[37:87, 101:165])
    assert received.sum(dtype=int) == image[37:87, 101:165].sum(dtype=int)

    row = download(console, kind="star_windows", slot=whole["slot"], side_px=9)
    frame = console.get(f"/frames/{row['frame_id']}")
    received = pixels(console, frame["id"])
    assert frame["part"] == "star_windows"
    assert len(frame["held"]) >= 4
    inside = np.zeros(image.shape, bool)
    for col, first, columns, rows in frame["held"]:
        inside[first : first + rows, col : col + columns] = True
    assert np.array_equal(received, np.where(inside, image, 0))
    stars = console.get(f"/frames/{whole['id']}")["on_board"]["stars"]
    for star in stars:
        assert inside[round(star["row_px"]), round(star["col_px"])]

    small = console.get(f"/frames/{download(console, kind='thumbnail', slot=whole['slot'])['frame_id']}")
    assert (small["part"], small["columns"]) == ("thumbnail", image.shape[1] // 4)

    for wrong in (
        {"kind": "region", "slot": 0},
        {"kind": "frame", "slot": 0, "region": box},
        {"kind": "region", "slot": 0, "region": box | {"col_px": 1000}},
        {"kind": "star_windows", "slot": 0, "side_px": 10},
        {"kind": "frame", "slot": 4},
        {"kind": "frame", "bank": "A"},
        {"kind": "catalogue", "slot": 0},
        {"kind": "catalogue", "bank": "Z"},
        {"kind": "parameters", "bank": "golden"},
    ):
        reply = console.http.post("/transfers/download", json=wrong)
        assert reply.status_code == 400, (wrong, reply.text)


def test_a_calibration_is_made_sent_activated_rolled_back_and_read_back(serve):
    """A calibration table is uploaded, activated, rolled back and read back with the same bytes. Invalid tables
    are rejected.
    """
    console = serve("--simulator", "cubestar").console
    online(console)
    console.wait("the tables on board", lambda: console.get("/tables/on-board"))
    plain = console.get("/tables/defaults", kind="calibration", profile="cubestar")["content"]
    body = {
        "kind": "calibration",
        "name": "after the oven",
        "profile": "cubestar",
        "content": {"k1": plain["k1"] + 0.001},
    }
    table = console.post("/tables", body)
    assert table["content"] == plain | {"k1": plain["k1"] + 0.001}
    transfer = console.post(f"/tables/{table['id']}/upload", {"bank": "B"})
    assert wait_for_state(console, transfer, "committed")["table_id"] == table["id"]

    def place():
        return [p for p in console.get(f"/tables/{table['id']}")["on_board"] if p["bank"] == "B"]

    console.wait("the report of bank B", lambda: place() == [{"bank": "B", "state": "committed", "active": False}])
    refused = console.http.post(
        "/commands", json={"name": "ACTIVATE_TABLE", "arguments": {"table": "calibration", "bank": "B"}}
    )
    assert refused.status_code == 400
    done = console.command("ACTIVATE_TABLE", confirm="ACTIVATE_TABLE", table="calibration", bank="B")
    assert done["result"] == "completed", done["detail"]
    console.wait("bank B to be active", lambda: place()[0]["active"])
    assert console.wait("the upload to be active", lambda: wait_for_state(console, transfer, "active"))
    busy = console.http.post(f"/tables/{table['id']}/upload", json={"bank": "B"})
    assert busy.status_code == 409
    assert console.command("ROLLBACK_TABLE", confirm="yes", table="calibration")["result"] == "completed"
    console.wait("bank B to be inactive", lambda: not place()[0]["active"])

    row = download(console, kind="calibration", bank="B")
    assert (row["table_id"], row["sha256"]) == (table["id"], table["sha256"])
    factory = console.get(f"/tables/{download(console, kind='parameters', bank='factory')['table_id']}")
    assert factory["author"] == "read back from the device"
    assert factory["content"]["chain"] == "cubestar"
    stars = console.get(f"/tables/{download(console, kind='star_list', bank='golden')['table_id']}")
    assert stars["kind"] == "star_list"
    assert len(console.http.get(f"/tables/{stars['id']}/file.bin").content) == stars["size"] > 1000

    for wrong in (
        body | {"content": {"k9": 1.0}},
        body | {"content": {"columns": 1000}},
        body | {"content": {"k1": "much"}},
        body | {"kind": "parameters", "content": {"chain": "unknown"}},
        body | {"kind": "triplets", "content": {}},
    ):
        reply = console.http.post("/tables", json=wrong)
        assert reply.status_code in (400, 404), reply.text
    other = console.post("/tables", {"kind": "calibration", "name": "", "profile": "sunsat", "content": {}})
    reply = console.http.post(f"/tables/{other['id']}/upload", json={"bank": "A"})
    assert (reply.status_code, reply.json()["expected"]) == (400, "cubestar")


def test_a_stored_frame_is_sent_up_and_solved_on_board(serve):
    """The sensor's own chain solves a frame that was uploaded. Its solution is stored with the frame and agrees."""
    console = serve("--simulator", "cubestar").console
    online(console)
    console.command("SET_MODE", mode="lost_in_space")
    console.command("TAKE_IMAGE")
    frame = console.wait("the frame", lambda: console.get("/frames")["frames"])[0]
    solved = console.wait(
        "the ground's solution", lambda: (d := console.get(f"/frames/{frame['id']}"))["ground"] and d, 60
    )
    assert solved["on_board"] is None
    assert solved["ground"]["outcome"] == "solved"
    frames_before = console.get("/frames")["total"]
    transfer = console.post(f"/frames/{frame['id']}/upload", {"slot": 2, "solve": True})
    assert wait_for_state(console, transfer, "committed")["frame_id"] == frame["id"]
    detail = console.wait(
        "the sensor's solution",
        lambda: (d := console.get(f"/frames/{frame['id']}"))["on_board"] and d["on_board"]["attitude"] and d,
        60,
    )
    assert detail["comparison"]["agree"], detail["comparison"]
    assert detail["on_board"]["verdict"] == "correct"
    console.wait(
        "the rerun on the ground", lambda: console.get(f"/frames/{frame['id']}")["on_board"]["replay"] == "equal"
    )
    assert console.get("/frames")["total"] == frames_before, "the ground's own picture was fetched back"
    names = [c["name"] for c in console.get("/commands", limit=20)]
    assert [n for n in reversed(names) if n in ("FIND_CENTROIDS", "MATCH_STARS", "CALCULATE_ATTITUDE")] == [
        "FIND_CENTROIDS",
        "MATCH_STARS",
        "CALCULATE_ATTITUDE",
    ]
    small = download(console, kind="thumbnail", slot=0)
    reply = console.http.post(f"/frames/{small['frame_id']}/upload", json={"slot": 0})
    assert (reply.status_code, "detector" in reply.json()["message"]) == (400, True)
    assert console.http.post(f"/frames/{frame['id']}/upload", json={"slot": 9}).status_code == 400


def test_slip_carries_a_whole_session_when_both_ends_are_set_to_it(serve):
    """GSS_FRAMING selects the framing of the line and of the simulator that the server starts."""
    console = serve("--simulator", "cubestar", GSS_FRAMING="slip").console
    online(console)
    console.command("TAKE_IMAGE")
    frame = console.wait("the frame", lambda: console.get("/frames")["frames"])[0]
    assert frame["complete"]
    counters = console.get("/link/counters")
    assert counters["framing"] == "slip"
    assert counters["received"]["bytes"] > frame["columns"] * frame["rows"]
    names = ("bad_crc", "too_long", "too_short", "unknown", "undecodable", "gaps", "duplicates", "repeated_ids")
    assert {name: counters["received"][name] for name in names} == dict.fromkeys(names, 0)
    assert counters["sent"]["device_bad"] == 0
    assert 0 < counters["sent"]["device_good"] <= counters["sent"]["good"]

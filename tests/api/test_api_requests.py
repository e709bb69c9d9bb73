"""Responses of the HTTP interface to valid and invalid requests."""

from __future__ import annotations

import csv
import io
import json
import time
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from astropy.io import fits
from PIL import Image

from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.frames import cam_from_icrs
from gss.instruments.registry import shipped_camera
from gss.pipeline.render import render
from gss.store.events import add as add_event


def png_of(pixels) -> bytes:
    """Return the pixels as a PNG file."""
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, format="PNG")
    return buffer.getvalue()


def fits_of(array) -> bytes:
    """Return the array as a FITS file."""
    buffer = io.BytesIO()
    fits.PrimaryHDU(array).writeto(buffer)
    return buffer.getvalue()


@pytest.fixture(scope="module")
def orion() -> bytes:
    """A rendered CubeStar frame of Orion."""
    profile = shipped_camera("cubestar")
    attitude = cam_from_icrs(*np.radians([84.0, 0.0, 313.0]))
    return png_of(
        render(load_stars(6.5), profile.camera, profile.sensor, attitude, 0.25, np.random.default_rng(1)).pixels
    )


def import_frame(client, data: bytes, name: str, profile_name: str = ""):
    """Import a file and return the response."""
    return client.post("/api/frames/import", files={"file": (name, data)}, data={"profile": profile_name})


def wait_for_solution(client, frame_id: int):
    """Wait for the first solution of the frame and return the frame."""
    for _ in range(600):
        detail = client.get(f"/api/frames/{frame_id}").json()
        if detail["solutions"]:
            return detail
        time.sleep(0.05)
    pytest.fail("no solution was stored")


def test_an_imported_frame_is_solved_stored_and_exported(client, orion):
    """An imported PNG is solved. The server returns attitude, overlays, pixels, pictures with ETags, and FITS with
    WCS.
    """
    reply = import_frame(client, orion, "orion.png", "cubestar")
    assert reply.status_code == 201, reply.text
    frame = wait_for_solution(client, reply.json()["id"])
    ground = frame["ground"]
    assert (ground["outcome"], ground["chain"]) == ("solved", "reference")
    assert ground["attitude"]["ra_deg"] == pytest.approx(84.0, abs=0.01)
    assert ground["attitude"]["roll_deg"] == pytest.approx(313.0, abs=0.05)
    assert {"Betelgeuse", "Bellatrix", "Saiph"} <= {s["name"] for s in ground["stars"] if s["hip"]}
    assert ground["grid"]
    assert all(0 <= abs(line["points"][0][0]) < 5000 for line in ground["grid"])

    original = np.asarray(Image.open(io.BytesIO(orion)))
    raw = client.get(f"/api/frames/{frame['id']}/raw")
    assert np.array_equal(np.frombuffer(raw.content, raw.headers["x-dtype"]).reshape(512, 1024), original)
    values = client.get(
        f"/api/frames/{frame['id']}/pixels", params={"col": -1, "row": 0, "columns": 3, "rows": 1}
    ).json()
    assert values["values"] == [[None, float(original[0, 0]), float(original[0, 1])]]
    histogram = client.get(f"/api/frames/{frame['id']}/histogram").json()
    assert sum(histogram["counts"]) == original.size
    assert Image.open(io.BytesIO(client.get(f"/api/frames/{frame['id']}/image.png").content)).size == (1024, 512)
    for view in ("image.png", "image.png?invert=true", "thumbnail.png", "raw"):
        reply = client.get(f"/api/frames/{frame['id']}/{view}")
        assert reply.headers["cache-control"] == "private, no-cache"
        again = client.get(f"/api/frames/{frame['id']}/{view}", headers={"If-None-Match": reply.headers["etag"]})
        assert (again.status_code, again.content) == (304, b"")
    other = client.get(f"/api/frames/{frame['id']}/image.png", headers={"If-None-Match": reply.headers["etag"]})
    assert other.status_code == 200

    with fits.open(io.BytesIO(client.get(f"/api/frames/{frame['id']}/file.fits").content)) as file:
        from astropy.wcs import WCS

        star = next(s for s in ground["stars"] if s["name"] == "Betelgeuse")
        ra, dec = WCS(file[0].header).all_pix2world([[star["col_px"], star["row_px"]]], 0)[0]
        assert (ra, dec) == (pytest.approx(88.793, abs=0.02), pytest.approx(7.407, abs=0.02))


def test_every_chain_runs_on_a_stored_frame_and_unknown_ones_are_rejected(client, orion):
    """Each chain returns a result for a stored frame, as for "Run a chain" on the page. An unknown chain is a 404."""
    frame_id = wait_for_solution(client, import_frame(client, orion, "again.png", "cubestar").json()["id"])["id"]
    for chain in ("cubestar", "reference"):
        reply = client.post(f"/api/frames/{frame_id}/solve", json={"chain": chain})
        assert reply.status_code == 201, reply.text
        assert reply.json()["outcome"] == "solved"
    reply = client.post(f"/api/frames/{frame_id}/solve", json={"chain": "reference", "fov_deg": 52.0})
    assert reply.json()["outcome"] in ("solved", "none")
    reply = client.post(f"/api/frames/{frame_id}/solve", json={"chain": "hubble"})
    assert (reply.status_code, "reference" in reply.json()["expected"]) == (404, True)


def test_a_rerun_with_changed_constants_names_them_and_a_preview_stores_nothing(client, orion):
    """The solution stores its options. A preview has id 0 and is not stored. Wrong names and values are rejected."""
    frame_id = wait_for_solution(client, import_frame(client, orion, "options.png", "cubestar").json()["id"])["id"]
    options = {o["name"]: o for o in client.get("/api/chains/cubestar/options", params={"profile": "cubestar"}).json()}
    assert (options["min_area_px"]["kind"], options["min_area_px"]["value"]) == ("integer", "6")
    assert "Erlank 2013" in options["min_area_px"]["source"]
    before = len(client.get(f"/api/frames/{frame_id}").json()["solutions"])
    body = {"chain": "cubestar", "options": {"min_area_px": "2", "threshold_dn": "5"}}
    preview = client.post(f"/api/frames/{frame_id}/solve", json=body | {"store": False}).json()
    assert (preview["id"], preview["options"]) == (0, "min_area_px=2, threshold_dn=5")
    assert len(client.get(f"/api/frames/{frame_id}").json()["solutions"]) == before
    stored = client.post(f"/api/frames/{frame_id}/solve", json=body).json()
    assert (stored["options"], stored["attitude"]) == (preview["options"], preview["attitude"])
    assert [s["hip"] for s in stored["stars"]] == [s["hip"] for s in preview["stars"]]
    plain = client.post(f"/api/frames/{frame_id}/solve", json={"chain": "cubestar"}).json()
    assert plain["options"] == ""
    assert len(plain["regions"]) < len(stored["regions"])
    for wrong in ({"no_such": "1"}, {"min_area_px": "many"}, {"acceptance": "hope"}):
        answer = client.post(f"/api/frames/{frame_id}/solve", json={"chain": "cubestar", "options": wrong})
        assert answer.status_code == 400, answer.text
    answer = client.post(f"/api/frames/{frame_id}/solve", json={"chain": "reference", "options": {"min_area_px": "2"}})
    assert answer.status_code == 400
    assert client.get("/api/chains/hubble/options", params={"profile": "cubestar"}).status_code == 404
    assert client.get("/api/chains/reference/options", params={"profile": "cubestar"}).json() == []


BAD_FILES = {
    "text named png": (b"this is not a picture", "x.png"),
    "nothing": (b"", "empty.fits"),
    "truncated FITS": (fits_of(np.ones((64, 64), np.float32))[:3000], "cut.fits"),
    "16 bit FITS with NaN": (fits_of(np.where(np.eye(64) > 0, np.nan, 1).astype(np.float32)), "nan.fits"),
    "FITS without an image": (fits_of(None), "header.fits"),
    "truncated PNG": (png_of(np.zeros((64, 64), np.uint8))[:60], "cut.png"),
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_an_invalid_file_is_rejected_with_a_message_and_nothing_is_stored(client, name):
    """Truncated, empty and other invalid files are a 400 with a message, and no frame is stored."""
    before = client.get("/api/frames").json()["total"]
    reply = import_frame(client, *BAD_FILES[name])
    assert reply.status_code == 400, reply.text
    problem = reply.json()
    assert problem["id"]
    assert problem["message"]
    assert client.get("/api/frames").json()["total"] == before


def test_a_frame_of_another_camera_is_stored_with_the_reason_for_no_solution(client):
    """A frame of 16 × 16 px does not fit CubeStar. It is stored, and a solve request states the expected size."""
    reply = import_frame(client, png_of(np.zeros((16, 16), np.uint8)), "small.png", "cubestar")
    assert reply.status_code == 201
    frame_id = reply.json()["id"]
    reply = client.post(f"/api/frames/{frame_id}/solve", json={"chain": "cubestar"})
    assert (reply.status_code, reply.json()["expected"]) == (400, "512 rows x 1024 columns")
    assert import_frame(client, png_of(np.zeros((16, 16), np.uint8)), "small.png", "hubble").status_code == 404
    assert client.get(f"/api/frames/{frame_id}").json()["sha256"]


def test_a_blank_frame_has_no_solution_and_a_reason(client):
    """A frame without stars has the outcome ``none`` and a reason."""
    frame = wait_for_solution(
        client, import_frame(client, png_of(np.full((512, 1024), 9, np.uint8)), "blank.png", "cubestar").json()["id"]
    )
    assert frame["ground"]["outcome"] == "none"
    assert frame["ground"]["reason"]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"faint_mag": -1.9}, "leaves no stars"),
        ({"profile": "hubble"}, "Unknown instrument"),
        ({"format": "floppy"}, "Unknown on-board format"),
        ({"orbit": "tle", "tle": "1 25544U nonsense", "start": "2026-12-01"}, ""),
        ({"orbit": "elements", "roll_deg": [5.0, -5.0]}, "roll"),
        ({"start": "yesterday"}, "not a date"),
        ({"bright_mag": 5.0}, "bright limit"),
        ({"faint_mag": 7.9}, "too large for the bank"),
    ],
)
def test_an_impossible_catalogue_is_rejected_with_a_message(client, change, words):
    """The response or the failed job states the problem, and nothing is stored."""
    before = len(client.get("/api/catalogues").json())
    reply = client.post("/api/catalogues", json=change)
    if reply.status_code == 202:
        job = reply.json()
        for _ in range(200):
            job = client.get(f"/api/jobs/{job['id']}").json()
            if job["state"] in ("done", "failed"):
                break
            time.sleep(0.05)
        assert job["state"] == "failed"
        assert words in job["text"]
    else:
        assert reply.status_code in (400, 404), reply.text
        assert words in reply.json()["message"]
    assert len(client.get("/api/catalogues").json()) == before


def test_a_built_catalogue_keeps_request_manifest_and_quality(client):
    """A stored catalogue has its request, manifest, quality and image. Its upload without a device is a conflict."""
    job = client.post("/api/catalogues", json={"name": "t", "faint_mag": 3.5}).json()
    for _ in range(200):
        job = client.get(f"/api/jobs/{job['id']}").json()
        if job["state"] != "queued" and job["finished"]:
            break
        time.sleep(0.05)
    detail = client.get(f"/api/catalogues/{job['result']['catalogue_id']}").json()
    assert detail["request"]["faint_mag"] == 3.5
    assert len(detail["manifest"]["hip"]) == detail["stars"]
    assert sum(detail["quality"]["histogram"]) == detail["quality"]["pointings"]
    image = client.get(f"/api/catalogues/{detail['id']}/image.bin").content
    assert len(image) == detail["bytes"]
    manifest = json.loads(client.get(f"/api/catalogues/{detail['id']}/manifest.json").text)
    assert manifest["image_sha256"] == detail["sha256"]
    reply = client.post(f"/api/catalogues/{detail['id']}/upload", json={"bank": "A"})
    assert (reply.status_code, reply.json()["message"]) == (409, "No device has answered.")


def test_commands_are_checked_without_a_link(client):
    """A check works without a link and reports values out of range. Sending is rejected, and unknown names are
    errors.
    """
    check = client.post("/api/commands/check", json={"name": "SET_EXPOSURE", "arguments": {"exposure_ms": 2001}}).json()
    assert any("1 – 2000" in p and "2001" in p for p in check["problems"]), check["problems"]
    good = client.post("/api/commands/check", json={"name": "SET_EXPOSURE", "arguments": {"exposure_ms": 1000}}).json()
    assert good["size"] == sum(len(bytes.fromhex(g["hex"].replace(" ", ""))) for g in good["bytes"])
    assert [g["argument"] for g in good["bytes"]].count(True) == 1
    assert client.post("/api/commands", json={"name": "GET_STATUS"}).status_code == 409
    assert client.post("/api/commands", json={"name": "MAKE_COFFEE"}).status_code == 404
    assert client.post("/api/commands", json={"name": "GET_STATUS", "extra": 1}).status_code == 422
    assert client.get("/api/commands").json() == []


@pytest.mark.parametrize("url", ["/dev/ttyNOWHERE", "nonsense://x", "socket://127.0.0.1:1", ""])
def test_a_port_that_cannot_be_opened_is_reported_at_once(client, url):
    """A closed port, an unknown scheme and a missing file are reported with a message."""
    reply = client.post("/api/link/open", json={"url": url})
    assert reply.status_code in (400, 404, 503), reply.text
    assert reply.json()["message"]


def test_only_an_admin_opens_a_link_to_another_machine(clients):
    """An operator may not open a link to another host, because the error text would reveal its open ports."""
    rejected = clients["operator"].post("/api/link/open", json={"url": "socket://192.0.2.1:22"})
    local = clients["operator"].post("/api/link/open", json={"url": "socket://127.0.0.1:9"})
    assert (rejected.status_code, "Only an admin" in rejected.json()["message"]) == (403, True)
    assert local.status_code == 503
    assert clients["admin"].post("/api/link/open", json={"url": "socket://127.0.0.2:9"}).status_code == 503


def test_events_are_ordered_and_resume_after_a_number(client):
    """The list of events is ordered by number and can be continued after a number."""
    import_frame(client, png_of(np.zeros((8, 8), np.uint8)), "event.png")
    events = client.get("/api/events").json()
    assert [e["seq"] for e in events] == sorted(e["seq"] for e in events)
    assert client.get("/api/events", params={"after": events[-1]["seq"]}).json() == []


def test_events_are_selected_by_number_and_time(client):
    """Each of after, start and end is optional. With after, the first events are returned, otherwise the latest ones of the
    time span. A number above the newest is of another database, and the latest events are returned."""
    first = datetime.now(UTC).replace(microsecond=0) + timedelta(hours=1)
    with client.app.state.services.base.database.unit_of_work() as session:
        for k in range(4):
            add_event(session, first + timedelta(seconds=k), "k", "ok", f"event {k}", {})

    def selected(**params):
        return [event["seq"] for event in client.get("/api/events", params=params).json()]

    times = {event["seq"]: event["at"] for event in client.get("/api/events").json()}
    *_, third, second, newest = numbers = list(times)
    assert selected(start=times[second], limit=2) == [second, newest]
    assert selected(end=times[second], limit=2) == [third, second]
    assert selected(start=times[third], end=times[second]) == [third, second]
    assert selected(start=times[third], after=0, limit=1) == [third]
    assert selected(after=third, end=times[second]) == [second]
    assert selected(after=newest + 100, limit=2) == [second, newest]
    assert selected() == numbers


@pytest.mark.parametrize("row", ["0", "-1", "2147483648", "9223372036854775808", "1180591620717411303424", "x"])
def test_ids_out_of_range_are_rejected(client, row):
    """Ids outside the range of the database are rejected before a query."""
    for path in (
        f"/api/frames/{row}",
        f"/api/commands/{row}",
        f"/api/jobs/{row}",
        f"/api/events?after={row if row != '0' else 'x'}",
    ):
        assert client.get(path).status_code == 422 or (row == "-1" and "events" not in path), path


@pytest.mark.parametrize("text", ["\\ud800", "\\u0000", "a\\udfffb"])
def test_invalid_characters_are_rejected_with_a_message(client, text):
    """Lone surrogates and NUL are rejected, because they can be neither stored nor displayed."""
    for path, field in (
        ("/api/commands/check", "name"),
        ("/api/link/open", "url"),
        ("/api/catalogues/preview", "profile"),
    ):
        reply = client.post(path, content=f'{{"{field}": "{text}"}}', headers={"Content-Type": "application/json"})
        assert reply.status_code == 422, reply.text
        assert "incomplete character" in reply.json()["message"]


@pytest.mark.parametrize(
    "url",
    [
        "spy:///dev/null?file=/tmp/x",
        "alt://x",
        "loop://",
        "socket://127.0.0.1:1\\r\\n",
        "rfc2217://127.0.0.1:1?timeout=100000",
        "socket://127.0.0.1:1?logging=debug",
        "socket://127.0.0.1:1/path",
        "socket://name:word@127.0.0.1:1",
        "socket://127.0.0.1:0",
    ],
)
def test_only_link_addresses_are_opened(client, url):
    """Schemes that write files or load code and addresses with options are rejected."""
    reply = client.post("/api/link/open", json={"url": url.encode().decode("unicode_escape")})
    assert (reply.status_code, reply.json()["message"]) == (400, "Invalid line address.")


@pytest.mark.parametrize(
    ("cards", "key"),
    [({"EXPTIME": 1e308}, "exposure_s"), ({"DATE-OBS": "9999-12-31T23:59:59"}, "taken"), ({}, "exposure_s")],
)
def test_implausible_headers_do_not_damage_a_frame(client, cards, key):
    """A frame with extreme exposures, dates or values is stored, and every view of it works."""
    hdu = fits.PrimaryHDU(np.full((40, 40), 1e29, np.float32))
    hdu.header.update(cards)
    buffer = io.BytesIO()
    hdu.writeto(buffer)
    reply = import_frame(client, buffer.getvalue(), "wild.fits")
    assert reply.status_code == 201, reply.text
    frame = wait_for_solution(client, reply.json()["id"])
    assert frame[key] is None or frame[key] < "2200"
    for view in ("image.png", "thumbnail.png", "histogram", "raw", "file.fits", "recording.rrd"):
        assert client.get(f"/api/frames/{frame['id']}/{view}").status_code == 200, view


def test_the_time_of_a_frame_is_known_only_if_the_file_states_it(client):
    """A file without a time is stored with the time of its import, marked as unknown. Its pixels and its solutions are
    exported without a date."""
    dated, undated = (fits.PrimaryHDU(np.zeros((8, 8), np.uint8)) for _ in range(2))
    dated.header["DATE-OBS"] = "2024-03-05T21:10:11"
    frames, dates = [], []
    for hdu in (dated, undated):
        buffer = io.BytesIO()
        hdu.writeto(buffer)
        frames.append(import_frame(client, buffer.getvalue(), "small.fits").json())
        exported = client.get(f"/api/frames/{frames[-1]['id']}/file.fits").content
        dates.append(fits.getheader(io.BytesIO(exported)).get("DATE-OBS"))
    assert [frame["time_known"] for frame in frames] == [True, False]
    assert frames[0]["taken"].startswith("2024-03-05T21:10:11")
    assert dates == ["2024-03-05T21:10:11.000", None]
    for frame in frames:
        wait_for_solution(client, frame["id"])
    solutions = csv.DictReader(client.get("/api/campaigns/solutions?format=csv").text.splitlines())
    taken = {int(row["frame_id"]): row["taken"] for row in solutions}
    assert [taken[frame["id"]] for frame in frames] == ["2024-03-05 21:10:11.000000Z", ""]


def test_parallel_imports_of_one_file_store_it_once(client, tmp_path):
    """Parallel imports of the same file all succeed and refer to the same stored content. A later import names the first
    frame with the same pixels."""
    from concurrent.futures import ThreadPoolExecutor

    data = png_of(np.random.default_rng(9).integers(0, 50, (64, 64), dtype=np.uint8))
    with ThreadPoolExecutor(8) as pool:
        replies = list(pool.map(lambda k: import_frame(client, data, f"{k}.png"), range(16)))
    assert {r.status_code for r in replies} == {201}
    assert len({r.json()["sha256"] for r in replies}) == 1
    first = min(r.json()["id"] for r in replies)
    assert client.get(f"/api/frames/{first}").json()["same_as"] is None
    again = import_frame(client, data, "again.png").json()
    assert again["same_as"] == first

"""Catalogues over HTTP: rejected input, differences, exports, reports, star lists and the timeline of banks."""

from __future__ import annotations

import json
import time
from datetime import UTC, datetime, timedelta
from typing import Any

import numpy as np
import pytest
from fastapi.testclient import TestClient

from gss.catalogue_tools.onboard import decode, read_c_source
from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.catalogue_tools.sources.star_list_export import write_star_list
from gss.cli import main
from gss.operations.catalogues.catalogue_files import TYPES, import_file
from gss.store import bank_history, devices
from gss.store.models import BankHistory

TLE = (
    "1 25544U 98067A   19343.69339541  .00001764  00000-0  38792-4 0  9991\n"
    "2 25544  51.6439 211.2001 0007417  17.6667  85.6398 15.50103472202482\n"
)
ORBIT = {"orbit": "elements", "inclination_deg": 97.0, "raan_deg": [133.0, 149.0], "start": "2026-12-01"}
STILL = {"pointing": "inertial", "roll_deg": [0.0, 0.0], "pitch_deg": [0.0, 0.0], "yaw_deg": [0.0, 0.0]}


def decayed() -> str:
    """Return the elements of the ISS with an impossible mean motion and valid checksums."""
    first, second = TLE.splitlines()
    second = second[:52] + "17.90103472" + second[63:68]
    total = sum(int(c) if c.isdigit() else c == "-" for c in second) % 10
    return f"{first}\n{second}{total}\n"


def build_catalogue(client: TestClient, **request: Any) -> dict[str, Any]:
    reply = client.post("/api/catalogues", json=request)
    assert reply.status_code == 202, reply.text
    for _ in range(400):
        job = client.get(f"/api/jobs/{reply.json()['id']}").json()
        if job["state"] in ("done", "failed"):
            assert job["state"] == "done", job["text"]
            catalogue: dict[str, Any] = client.get(f"/api/catalogues/{job['result']['catalogue_id']}").json()
            return catalogue
        time.sleep(0.05)
    pytest.fail("the catalogue was not built")


@pytest.fixture(scope="module")
def pair(client: TestClient) -> tuple[dict[str, Any], dict[str, Any]]:
    """Two catalogues: one for two weeks and one for the following two weeks."""
    later = ORBIT | {"raan_deg": [149.0, 165.0]}
    first = build_catalogue(client, name="first", faint_mag=4.0, **ORBIT)
    return first, build_catalogue(
        client, name="second", faint_mag=4.0, corrections={"annual_aberration": True}, **later
    )


@pytest.mark.parametrize(
    ("request_", "words"),
    [
        ({"orbit": "tle", "tle": TLE.replace("9991", "9992"), "start": "2019-12-10"}, "wrong checksum"),
        ({"orbit": "tle", "tle": TLE, "start": "2026-12-01"}, "outside the TLE's validity"),
        ({"orbit": "tle", "tle": decayed(), "start": "2019-12-10"}, "does not describe an orbit"),
        (
            {**STILL, "ra_deg": 57.3, "dec_deg": -57.3, "faint_mag": 0.0, "profile": "sunsat"},
            "star lies in the envelope",
        ),
        (ORBIT | {"roll_deg": [5.0, -5.0]}, "minimum is above the maximum"),
        (ORBIT | {"raan_deg": [149.0, 133.0]}, "minimum is above the maximum"),
        ({"faint_mag": 2.0, "bright_mag": 3.0}, "bright limit is not brighter"),
        ({"faint_mag": -1.9}, "leaves no stars"),
        ({"faint_mag": 7.9}, "too large for the bank"),
        (ORBIT | {"epoch_jyear": 1900.0}, "epoch of the positions is far"),
        ({"faint_mag": 9.0}, "does not reach this magnitude limit"),
        ({"orbit": "none", "corrections": {"orbital_aberration": True}}, "needs an orbit"),
        ({"occultation": {"earth": True}}, "needs the altitude"),
        (ORBIT | {"body_from_cam": [0.5, 0, 0, 0, 1.0, 0, 0, 0, 1.0]}, "mounting is not a rotation"),
        ({"source": "list"}, "No star list was selected"),
        (STILL | {"method": "blocks"}, "follows the orbit"),
    ],
)
def test_each_impossible_request_is_rejected_at_once(client: TestClient, request_: Any, words: str) -> None:
    """The response is a 400 with the expected and received values or an instruction. No job is queued."""
    before = len(client.get("/api/jobs").json())
    reply = client.post("/api/catalogues", json=request_)
    assert reply.status_code == 400, reply.text
    problem = reply.json()
    assert words in problem["message"]
    assert problem["expected"] or problem["got"] or problem["hint"]
    assert len(client.get("/api/jobs").json()) == before


def test_a_decayed_orbit_is_reported(client: TestClient) -> None:
    """The preview reports the error of SGP4 as a message."""
    body = {"orbit": "tle", "tle": decayed(), "start": "2019-12-10"}
    problem = client.post("/api/catalogues/preview", json=body).json()
    assert problem["got"] == "the orbit has decayed"


@pytest.mark.parametrize("pointing", ["sunsat", "zenith", "nadir", "target", "inertial", "anti_sun", "sun_pointing"])
def test_every_law_can_be_previewed(client: TestClient, pointing: str) -> None:
    """The preview of each pointing law has stars, a funnel and a map."""
    body = ORBIT | {"pointing": pointing, "profile": "sunsat", "format": "sunsat", "faint_mag": 5.0, "days": 3.0}
    quick = client.post("/api/catalogues/preview", json=body).json()
    assert 5 < quick["stars"] < 1600
    assert quick["funnel"][-1] == {"label": "kept", "stars": quick["stars"], "kind": "keep"}
    assert max(quick["envelope"]["fraction"]) > 0
    assert quick["bytes_estimate"] < quick["bank_bytes"]


def test_a_star_list_is_read_reported_and_built_from(client: TestClient) -> None:
    """An upload reports dropped rows with reasons. The build uses the other rows and names the list in its manifest."""
    lines = write_star_list(load_stars(4.0), "csv").decode().splitlines()
    head = next(k for k, line in enumerate(lines) if line and not line.startswith("#"))
    invalid_row = lines[head + 3].split(",")
    ra_column = next(k for k, name in enumerate(lines[head].split(",")) if name.lower().startswith("ra"))
    invalid_row[ra_column] = "nan"
    lines[head + 3] = ",".join(invalid_row)
    reply = client.post("/api/catalogues/sources", files={"file": ("mine.csv", "\n".join(lines).encode())})
    assert reply.status_code == 201, reply.text
    row = reply.json()
    assert (row["stars"], row["dropped"]) == (len(load_stars(4.0)) - 1, 1)
    assert row["report"]["dropped"][0]["reason"]
    assert client.get("/api/catalogues/sources").json()[0]["id"] == row["id"]
    detail = build_catalogue(client, name="of mine", source="list", star_list=row["id"], faint_mag=3.5)
    assert detail["manifest"]["source_facts"]["name"] == "list"
    assert detail["funnel"][0] == {"label": "mine.csv", "stars": row["stars"], "kind": "keep"}


@pytest.mark.parametrize(
    ("name", "text", "form", "words"),
    [
        ("a.doc", "x", {}, "Unknown kind of star list"),
        ("a.csv", "id,ra_deg,dec_deg,v_mag\n", {"mapping": '{"epoch_jyear": 2000}'}, "empty"),
        (
            "a.csv",
            "id,ra_deg,dec_deg,v_mag\n1,10,10,3\n1,20,20,3\n",
            {"mapping": '{"epoch_jyear": 2000, "frame": "icrs", "bad_rows": "refuse"}'},
            "twice",
        ),
        (
            "a.csv",
            "id,ra_deg,dec_deg,v_mag\n1,nan,10,3\n2,20,20,3\n",
            {"mapping": '{"epoch_jyear": 2000, "frame": "icrs", "bad_rows": "refuse"}'},
            "Row 1, column ra_deg",
        ),
        ("a.csv", "id,ra_deg,dec_deg,v_mag\n1,10,10,3\n", {"mapping": '{"epoch_jyear": 1000}'}, "poch"),
        ("a.csv", "id,ra_deg,dec_deg,v_mag\n1,10,10,3\n", {"mapping": "what"}, "column mapping"),
        ("a.csv", "id,ra_deg,dec_deg,v_mag\n1,10,10,3\n", {"profile": "hubble"}, "Unknown instrument"),
    ],
)
def test_each_invalid_list_is_rejected_with_a_message(
    client: TestClient, name: str, text: str, form: dict[str, str], words: str
) -> None:
    """Lists with NaN, duplicate numbers, a wrong epoch or an unknown kind are rejected, and nothing is stored."""
    before = len(client.get("/api/catalogues/sources").json())
    reply = client.post("/api/catalogues/sources", files={"file": (name, text.encode())}, data=form)
    assert reply.status_code in (400, 404), reply.text
    assert words in reply.json()["message"]
    assert len(client.get("/api/catalogues/sources").json()) == before


@pytest.mark.parametrize(
    "mapping",
    [
        "[]",
        "[1]",
        "[" * 3000,
        "null",
        '{"pm_ra_has_cos_dec": "no", "epoch_jyear": 2000, "frame": "icrs"}',
        '{"epoch_jyear": "2000", "frame": "icrs"}',
        '{"epoch_jyear": NaN, "frame": "icrs"}',
        '{"columns": {"ra": "dec_deg"}, "epoch_jyear": 2000, "frame": "icrs"}',
        '{"bogus": 1}',
    ],
)
def test_each_invalid_mapping_is_rejected_with_a_message(client: TestClient, mapping: str) -> None:
    """A mapping of another type, with a column used twice or with deep nesting is a 400 that states the expected
    form.
    """
    before = len(client.get("/api/catalogues/sources").json())
    rows = "id,ra_deg,dec_deg,v_mag\n1,10,10,3\n"
    reply = client.post("/api/catalogues/sources", files={"file": ("a.csv", rows.encode())}, data={"mapping": mapping})
    assert reply.status_code == 400, reply.text
    assert reply.json()["expected"]
    assert len(client.get("/api/catalogues/sources").json()) == before


def test_a_name_with_a_line_break_is_rejected(client: TestClient) -> None:
    """Control characters in the name of a catalogue are rejected. Letters of any alphabet are accepted."""
    reply = client.post("/api/catalogues", json={"name": "a\nb"})
    assert reply.status_code in (400, 422)
    assert "author of the catalogue contains control characters" in reply.json()["message"]
    assert client.post("/api/catalogues/preview", json={"name": "Nächte 2026", "faint_mag": 2.5}).status_code == 200


def test_a_list_for_another_camera_is_rejected(client: TestClient) -> None:
    """A star list that was imported for one camera cannot be used for another camera."""
    data = write_star_list(load_stars(3.0), "csv")
    row = client.post("/api/catalogues/sources", files={"file": ("s.csv", data)}, data={"profile": "sunsat"}).json()
    reply = client.post("/api/catalogues/preview", json={"source": "list", "star_list": row["id"], "faint_mag": 2.5})
    assert (reply.status_code, reply.json()["message"]) == (400, "This star list is for another camera.")
    assert (reply.json()["expected"], reply.json()["got"]) == ("sunsat", "cubestar")
    file_with_camera = {"file": ("s.csv", b"# camera = sunsat\n" + data)}
    rejected = client.post("/api/catalogues/sources", files=file_with_camera, data={"profile": "cubestar"})
    assert (rejected.status_code, rejected.json()["message"]) == (400, "This star list is for another camera.")
    row = client.post("/api/catalogues/sources", files=file_with_camera).json()
    assert row["profile"] == "sunsat"
    reply = client.post("/api/catalogues", json={"source": "list", "star_list": row["id"], "faint_mag": 2.5})
    assert (reply.status_code, reply.json()["message"]) == (400, "This star list is for another camera.")


def test_the_selection_of_stars_is_configurable_and_reported(client: TestClient) -> None:
    """Preview, detail, report and manifest show screening list, reduced catalogue, thinning and the mounting by three
    rotations. Two mountings in one request are rejected.
    """
    requested: dict[str, Any] = {
        "faint_mag": 4.5,
        "pointing": "inertial",
        "mounting_deg": [-10, 0, 90],
        "thinning": "frames",
        "brightest_per_field": 12,
        "screening": {"action": "drop", "most_companions": 3, "tolerance_deg": 0.05},
        "reduced": {"width_deg": 36, "height_deg": 36, "step_deg": 4},
    }
    quick = client.post("/api/catalogues/preview", json=requested).json()
    detail = build_catalogue(client, name="chosen", **requested)
    assert [f["label"] for f in quick["funnel"]] == [f["label"] for f in detail["funnel"]]
    dropped_stars = next(f["stars"] for f in detail["funnel"] if f["label"] == "on the screening list")
    assert dropped_stars > 0
    assert detail["screening"]["counts"]["any"] >= dropped_stars
    assert detail["screening"]["stars"][0]["reasons"]
    assert 0 < detail["reduced_stars"] <= detail["stars"]
    assert detail["manifest"]["parameters"]["rules"]["thinning"] == "frames"
    assert detail["request"]["mounting_deg"] == [-10, 0, 90]
    assert "Screening list" in client.get(f"/api/catalogues/{detail['id']}/report.html").text
    two_mountings = requested | {"body_from_cam": [1, 0, 0, 0, 1, 0, 0, 0, 1]}
    reply = client.post("/api/catalogues/preview", json=two_mountings)
    assert (reply.status_code, reply.json()["message"]) == (400, "Two mountings were given.")


def test_difference_of_two_stored_catalogues(client: TestClient, pair: Any) -> None:
    """The difference has consistent counts, moved and added stars, and the coverage of both catalogues."""
    old, new = pair
    difference = client.get("/api/catalogues/diff", params={"old": old["id"], "new": new["id"]}).json()
    assert difference["added_count"] - difference["dropped_count"] == new["stars"] - old["stars"]
    assert difference["same_count"] + difference["moved_count"] + difference["dropped_count"] == old["stars"]
    # Aberration shifts every star of the second catalogue except near the direction of motion.
    assert difference["moved_count"] > 0.8 * (difference["same_count"] + difference["moved_count"])
    assert max(s["moved_arcsec"] for s in difference["moved"]) < 21.0
    assert sum(difference["coverage"]["new"]) != sum(difference["coverage"]["old"])
    assert len(difference["coverage"]["new"]) == 12 * difference["coverage"]["nside"] ** 2
    assert difference["added"][0]["v_mag"] <= difference["added"][-1]["v_mag"]
    same = client.get("/api/catalogues/diff", params={"old": old["id"], "new": old["id"]}).json()
    assert same["nothing"]
    assert client.get("/api/catalogues/diff", params={"old": old["id"], "new": 999_999}).status_code == 404


@pytest.mark.parametrize("kind", TYPES)
def test_each_export_contains_the_catalogue(client: TestClient, pair: Any, kind: str) -> None:
    """Exported images and tables contain the bytes of the stored image. The other formats list each star."""
    detail = pair[0]
    reply = client.get(f"/api/catalogues/{detail['id']}/export", params={"kind": kind})
    assert reply.status_code == 200, reply.text
    image = client.get(f"/api/catalogues/{detail['id']}/image.bin").content
    name = reply.headers["content-disposition"].split('"')[1]
    if kind == "image":
        assert reply.content == image
    elif kind == "manifest":
        assert json.loads(reply.content)["image_sha256"] == detail["sha256"]
    elif kind == "c":
        assert decode(read_c_source(reply.text)).icrs.shape == (detail["stars"], 3)
    elif kind.startswith("tables-"):
        assert import_file(reply.content, name) == image
    elif kind == "csv":
        assert len(reply.text.strip().splitlines()) == 1 + detail["stars"]
    else:
        assert len(reply.content) > 8 * detail["stars"]
    assert client.get(f"/api/catalogues/{detail['id']}/export", params={"kind": "papyrus"}).status_code == 422


def test_the_report_is_one_self_contained_page(client: TestClient, pair: Any) -> None:
    """The report contains the figures of the catalogue, no script and no external resource."""
    detail = pair[1]
    page = client.get(f"/api/catalogues/{detail['id']}/report.html")
    assert page.headers["content-type"].startswith("text/html")
    assert "<script" not in page.text
    assert "http://" not in page.text.replace("http://www.w3.org", "")
    assert page.text.count("<svg") >= 3
    for words in ("second", "annual_aberration", detail["sha256"], f">{detail['stars']}<", "Stars per field"):
        assert words in page.text


def test_the_detail_lists_corrections_sizes_and_the_sun(client: TestClient, pair: Any) -> None:
    """The manifest lists applied corrections with their size. The sizes of the parts add up to the image. The Sun is
    drawn.
    """
    detail = pair[1]
    applied = {c["name"]: c for c in detail["manifest"]["corrections"]["applied"]}
    assert set(applied) == {"proper_motion", "annual_aberration"}
    assert 19 < np.degrees(applied["annual_aberration"]["largest"]) * 3600 < 21
    assert sum(detail["sizes"]["by_part"].values()) == detail["bytes"]
    assert "Sun" in [w["name"] for w in detail["wanderers"]]
    assert detail["manifest"]["version"] == 2


def test_banks_by_date(client: TestClient, pair: Any) -> None:
    """The server returns a device's bank reports as a timeline with validity and coverage. Without reports the
    response is a 404 with a message.
    """
    empty = client.get("/api/catalogues/timeline")
    assert (empty.status_code, empty.json()["message"]) == (404, "No banks recorded.")
    now = datetime.now(UTC)
    with client.app.state.services.base.database.unit_of_work() as session:  # type: ignore[attr-defined]
        facts = {"profile": "cubestar", "firmware": "1", "simulated": True, "dictionary_hash": "0"}
        device = devices.remember(session, now, name="FM2", **facts)  # type: ignore[arg-type]
        row = BankHistory(device_id=device.id, bank="B", state="active", sha256=pair[0]["sha256"])
        row.began = row.reported = now - timedelta(days=1)
        bank_history.add(session, row)
        contact = devices.open_contact(session, "tcp", now - timedelta(hours=5), "c")
        devices.update_contact(session, contact.id, device_id=device.id)
        contact.ended = now - timedelta(hours=4)
        contact_id = contact.id
    timeline = client.get("/api/catalogues/timeline").json()
    assert timeline["device"]["name"] == "FM2"
    (stay,) = timeline["stays"]
    assert (stay["bank"], stay["name"], stay["catalogue_id"]) == ("B", "first", pair[0]["id"])
    assert stay["valid_to"] == pair[0]["valid_to"]
    assert timeline["cover"]["text"]
    assert [(c["id"], c["ended"] is None) for c in timeline["contacts"]] == [(contact_id, False)]
    span = {"start": "2026-12-02T00:00:00Z", "end": "2026-12-01T00:00:00Z"}
    assert client.get("/api/catalogues/timeline", params=span).status_code == 400


def test_without_a_sensor_the_bank_size_is_that_of_the_package(client: TestClient) -> None:
    """A preview uses the bank size of the instrument's package, not that of the shipped instruments."""
    folder = client.app.state.services.base.settings.instruments_folder
    assert main(["instrument", "new", "small_unit", "--from", "sunsat", "--into", str(folder)]) == 0
    catalogue = folder / "small_unit" / "catalogue.yaml"
    catalogue.write_text(catalogue.read_text().replace("bank_bytes: 196608", "bank_bytes: 131072"))
    body = ORBIT | {"pointing": "sunsat", "format": "sunsat", "faint_mag": 5.0, "days": 3.0}
    for profile, bank_bytes in (("sunsat", 196_608), ("small_unit", 131_072)):
        quick = client.post("/api/catalogues/preview", json=body | {"profile": profile}).json()
        assert (quick["bank_bytes"], quick["bank_source"]) == (bank_bytes, "usual")

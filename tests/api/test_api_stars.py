"""Stars over HTTP: search, and the facts of a star."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient

from gss.store import catalogues, frames
from gss.store.models import Catalogue, Frame, Solution

BETELGEUSE, RIGEL = 27989, 24436
AT = datetime(2026, 3, 1, tzinfo=UTC)
MATCH: dict[str, Any] = {
    **dict.fromkeys(("index", "area_px"), 1),
    **dict.fromkeys(("col_px", "row_px", "flux_dn", "peak_dn", "weight", "dx_arcsec", "dy_arcsec"), 1.0),
    "hip": BETELGEUSE,
    "name": "Betelgeuse",
    "v_mag": 0.45,
    "dx_px": 0.03,
    "dy_px": -0.04,
}


def catalogue_row(name: str, manifest: dict[str, Any]) -> Catalogue:
    """Return a catalogue's row with this manifest."""
    texts = {"profile": "cubestar", "format": "vector_list", "author": "ann", "sha256": name * 32}
    numbers = {"stars": 2, "pairs": 1, "size": 64}
    return Catalogue(name=name, created=AT, request={}, manifest=manifest, report={}, **texts, **numbers)


def frame_row(name: str) -> Frame:
    """Return a frame's row."""
    size = {"columns": 8, "rows": 8, "bits": 8, "dtype": "|u1"}
    return Frame(source="file", name=name, taken=AT, received=AT, sha256=name * 32, **size)


@pytest.fixture(scope="module")
def stored(app: FastAPI) -> int:
    """Store three catalogues, one of them without star numbers, and two solved frames. Return the id of the frame in
    which Betelgeuse was matched."""
    with app.state.services.base.database.unit_of_work() as session:
        for name, manifest in (("aa", {"hip": [BETELGEUSE, RIGEL]}), ("bb", {"hip": [RIGEL]}), ("cc", {})):
            catalogues.add(session, catalogue_row(name, manifest))
        matched, other = frames.add(session, frame_row("dd")), frames.add(session, frame_row("ee"))
        for frame, star in ((matched, MATCH), (other, MATCH | {"hip": RIGEL, "name": "Rigel"})):
            chain = {"origin": "ground", "chain": "reference", "version": "1", "outcome": "solved"}
            result = {"created": AT, "operational": True, "detail": {"stars": [star]}}
            frames.add_solution(session, Solution(frame_id=frame.id, **chain, **result))
        return matched.id


def test_a_search_returns_exact_stars_first(clients: dict[str, TestClient]) -> None:
    """A viewer finds stars by name and number. A star that the table does not contain is not found, and the size of
    the table is stated."""
    search = clients["viewer"].get("/api/stars", params={"q": "rigel"}).json()
    assert (search["stars"][0]["hip"], search["stars"][0]["exact"]) == (RIGEL, True)
    assert (search["table_stars"], search["named_stars"]) == (117972, 4535)
    by_number = clients["viewer"].get("/api/stars", params={"q": "HIP 27989"}).json()["stars"]
    assert [(s["name"], s["other_names"]) for s in by_number] == [("Betelgeuse", ["α Ori", "58 Ori"])]
    assert clients["viewer"].get("/api/stars", params={"q": "HIP 999999"}).json()["stars"] == []


def test_a_search_tolerates_one_typing_error(clients: dict[str, TestClient]) -> None:
    """If no name contains the text, stars with one missing, additional, wrong or exchanged letter are found, but not as
    exact results. Texts with three letters and texts with two errors find no star."""

    def found(q: str) -> list[tuple[str, bool]]:
        reply = clients["viewer"].get("/api/stars", params={"q": q}).json()
        return [(star["name"], star["exact"]) for star in reply["stars"]]

    for text in ("betelguese", "betlgeuse", "betelgeusse", "Betelgeuze", "alpha orj"):
        assert found(text)[:1] == [("Betelgeuse", False)], text
    assert [found(text) for text in ("betelguesse", "xeg")] == [[], []]


def test_an_unknown_proper_motion_is_not_given_as_zero(clients: dict[str, TestClient]) -> None:
    """A star without a solution in Hipparcos has its position at J2000 and no proper motion and parallax."""
    card = clients["viewer"].get("/api/stars/55203").json()
    assert "proper motion unknown" in card["flags"]
    assert (card["epoch_jyear"], card["proper_motion_mas_yr"], card["parallax_mas"]) == (2000.0, None, None)


def test_the_facts_of_a_star_name_its_catalogues_and_frames(clients: dict[str, TestClient], stored: int) -> None:
    """The facts contain the position at the present epoch, and only catalogues and frames that contain the star."""
    card = clients["viewer"].get(f"/api/stars/{BETELGEUSE}").json()
    assert (card["name"], card["v_mag"]) == ("Betelgeuse", pytest.approx(0.45, abs=0.05))
    assert card["other_names"] == ["α Ori", "58 Ori"]
    assert card["ra_deg"] == pytest.approx(88.793, abs=0.01)
    assert card["dec_deg"] == pytest.approx(7.407, abs=0.01)
    assert "variable" in card["flags"]
    assert card["epoch_jyear"] > 2020
    assert [c["name"] for c in card["catalogues"]] == ["aa"]
    assert (card["checked_catalogues"], card["unnumbered"], card["unknown_banks"]) == (3, 1, [])
    assert [(f["id"], f["residual_px"]) for f in card["frames"]] == [(stored, pytest.approx(0.05, abs=1e-3))]
    assert card["checked_frames"] == 2


@pytest.mark.parametrize("hip", [0, 999_998, 10**30])
def test_a_star_outside_the_table_is_an_error(clients: dict[str, TestClient], hip: int) -> None:
    """The error states that the star table does not contain the number, and how to find a star."""
    reply = clients["viewer"].get(f"/api/stars/{hip}")
    assert reply.status_code == 404
    problem = reply.json()
    assert problem["message"] == "The star table does not contain this star."
    assert (problem["expected"], problem["got"]) == ("one of the 117972 Hipparcos stars", f"HIP {hip}")
    assert "palette" in problem["hint"]

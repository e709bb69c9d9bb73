"""Shared views over HTTP: storage, use by other users, versions, permissions and invalid input."""

from __future__ import annotations

import pytest

from gss.operations.requests import names_row

PATH = "/telemetry?own=power&fields=housekeeping.mode&plot=housekeeping.mode"


def view_body(**values):
    """Return the request body of a view, with ``values`` replaced."""
    return {"name": "Power", "path": PATH} | values


def test_a_view_is_the_same_for_another_user_and_changes_by_version(clients) -> None:
    """Other users can read a view, and change it only if it is open. A change of an outdated version is rejected."""
    ann, bob, eve = clients["operator"], clients["engineer"], clients["viewer"]
    stored = ann.post("/api/views", json=view_body(note="for the night shift")).json()
    assert (stored["owner"], stored["version"], stored["open"]) == ("the operator", 1, False)
    link = f"/api/views/{stored['id']}"
    assert bob.get(link).json()["path"] == PATH
    assert [row["name"] for row in eve.get("/api/views").json()] == ["Power"]
    changed = view_body(path="/telemetry?page=power", version=1)
    assert (bob.put(link, json=changed).status_code, bob.delete(link).status_code) == (403, 403)
    assert (eve.post("/api/views", json=view_body(name="b")).status_code, eve.delete(link).status_code) == (403, 403)
    assert ann.put(link, json=view_body(open=True, version=1)).json()["version"] == 2
    late = bob.put(link, json=changed | {"open": True})
    assert late.status_code == 409
    assert "has changed since you opened it" in late.json()["message"]
    assert late.json()["expected"] == "version 2, of the operator"
    assert bob.put(link, json=changed | {"version": 2, "open": False}).status_code == 403
    assert bob.put(link, json=changed | {"version": 2, "open": True}).json()["user"] == "the engineer"
    detail = eve.get(link).json()
    assert [(row["version"], row["user"]) for row in detail["versions"]] == [
        (3, "the engineer"),
        (2, "the operator"),
        (1, "the operator"),
    ]
    assert detail["versions"][2]["path"] == PATH
    assert ann.delete(link).status_code == 204
    assert ann.get(link).status_code == 404


@pytest.mark.parametrize(
    "path",
    [
        "telemetry",
        "//evil.example",
        "https://evil.example",
        "/\\evil.example",
        "/api/backup",
        "/views/1",
        "/a b",
        "/é",
        "/\n",
        "",
    ],
)
def test_only_pages_of_the_console_are_stored(clients, path: str) -> None:
    """Addresses outside the console, of data or of a view are rejected."""
    assert clients["operator"].post("/api/views", json=view_body(path=path)).status_code == (400 if path else 422)


def test_names_are_unique_and_readable(clients) -> None:
    """A second view with the same name is a conflict. An empty name is rejected."""
    ann = clients["operator"]
    assert ann.post("/api/views", json=view_body()).status_code == 201
    assert ann.post("/api/views", json=view_body(name=" Power ")).status_code == 409
    assert ann.post("/api/views", json=view_body(name="  ")).status_code == 400
    other = ann.post("/api/views", json=view_body(name="Heat")).json()
    assert ann.put(f"/api/views/{other['id']}", json=view_body(version=1)).status_code == 409


def test_each_role_has_a_start_page_and_a_user_can_choose_another(clients) -> None:
    """The session states the start page of the role and the chosen one, which other users do not get. An address
    outside the console is rejected, and "" returns to the page of the role."""
    pages = {role: c.get("/api/session").json().get("role_start_page") for role, c in clients.items() if role}
    assert pages == {
        "viewer": "/live",
        "operator": "/live",
        "catalogue manager": "/catalogues",
        "engineer": "/frames",
        "admin": "/admin",
    }
    viewer = clients["viewer"]
    chosen = viewer.put("/api/session/start-page", json={"path": PATH}).json()
    assert (chosen["start_page"], chosen["role"]) == (PATH, "viewer")
    assert viewer.get("/api/session").json()["start_page"] == PATH
    assert clients["operator"].get("/api/session").json()["start_page"] == ""
    escapes = ("/%2e%2e/api", "/%61pi/session", "/live/%2e%2e/api", "/./api", "/.", "/live/./x", "/API/x", "/live#x")
    for path in ("//evil.example", "/", "/?a=1", "/setup", "/units/B/live", "/live/../x", *escapes):
        assert viewer.put("/api/session/start-page", json={"path": path}).status_code == 400, path
    assert viewer.get("/api/session").json()["start_page"] == PATH
    assert viewer.put("/api/session/start-page", json={"path": ""}).json()["start_page"] == ""


@pytest.mark.parametrize(
    ("path", "named"),
    [
        ("/frames/12", True),
        ("/views/4", True),
        ("/commands?id=3", True),
        ("/calibration?frames=1-4,9", True),
        ("/stars/27989", False),
        ("/frames?stars=4&mode=tracking", False),
        ("/telemetry?plot=housekeeping.frame_id&from=2026-01-01", False),
        ("/telemetry/derived", False),
    ],
)
def test_an_address_with_the_number_of_a_row_is_recognised(path, named) -> None:
    """Such an address names a record of one unit. The numbers of stars, and filters, have the same meaning in all units."""
    assert names_row(path) is named

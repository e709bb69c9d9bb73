"""Shared views over HTTP: stored, opened by another user, versions, permission, and bad input."""

from __future__ import annotations

import pytest

PATH = "/telemetry?own=power&fields=housekeeping.mode&plot=housekeeping.mode"


def view(**values):
    """Return a view to store."""
    return {"name": "Power", "path": PATH} | values


def test_a_view_is_the_same_for_another_user_and_changes_by_version(clients) -> None:
    """Another user reads it by its number, may not change it until it is opened, and does not overwrite a newer version."""
    ann, bob, eve = clients["operator"], clients["engineer"], clients["viewer"]
    made = ann.post("/api/views", json=view(note="for the night shift")).json()
    assert (made["owner"], made["version"], made["open"]) == ("the operator", 1, False)
    link = f"/api/views/{made['id']}"
    assert bob.get(link).json()["path"] == PATH
    assert [one["name"] for one in eve.get("/api/views").json()] == ["Power"]
    changed = view(path="/telemetry?page=power", version=1)
    assert (bob.put(link, json=changed).status_code, bob.delete(link).status_code) == (403, 403)
    assert (eve.post("/api/views", json=view(name="b")).status_code, eve.delete(link).status_code) == (403, 403)
    assert ann.put(link, json=view(open=True, version=1)).json()["version"] == 2
    late = bob.put(link, json=changed | {"open": True})
    assert late.status_code == 409
    assert "has changed since you opened it" in late.json()["message"]
    assert late.json()["expected"] == "version 2, of the operator"
    assert bob.put(link, json=changed | {"version": 2, "open": False}).status_code == 403
    assert bob.put(link, json=changed | {"version": 2, "open": True}).json()["user"] == "the engineer"
    detail = eve.get(link).json()
    assert [(one["version"], one["user"]) for one in detail["versions"]] == [
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
    """An address outside, of data, or of a view is refused."""
    assert clients["operator"].post("/api/views", json=view(path=path)).status_code == (400 if path else 422)


def test_names_are_unique_and_readable(clients) -> None:
    """A second view of the name is a conflict; an empty name is refused."""
    ann = clients["operator"]
    assert ann.post("/api/views", json=view()).status_code == 201
    assert ann.post("/api/views", json=view(name=" Power ")).status_code == 409
    assert ann.post("/api/views", json=view(name="  ")).status_code == 400
    other = ann.post("/api/views", json=view(name="Heat")).json()
    assert ann.put(f"/api/views/{other['id']}", json=view(version=1)).status_code == 409

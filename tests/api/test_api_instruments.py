"""Instrument packages over HTTP: list, details, check, installation, export, comparison, permissions and audit rows."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient

from gss.instruments.package_source import read_package_files, read_zip, write_zip
from gss.instruments.registry import SHIPPED
from gss.operations.clock import utc_now
from gss.settings import Settings
from gss.store.models import Catalogue, Contact, Frame
from gss.wiring.build import build

CUBESTAR = read_package_files(SHIPPED / "cubestar")


def package(name: str, *changes: tuple[str, str, str]) -> bytes:
    """Return a zipped copy of the cubestar package under another name. ``changes``: (file, old text, new text)."""
    files = dict(CUBESTAR)
    for file, old, new in (("instrument.yaml", "id: cubestar", f"id: {name}"), *changes):
        text = files[file].decode()
        assert old in text
        files[file] = text.replace(old, new, 1).encode()
    return write_zip(name, files)


def upload(client: TestClient, path: str, data: bytes) -> Any:
    """Upload a package as the form of the page does."""
    return client.post(path, files={"file": ("package.zip", data, "application/zip")})


@pytest.fixture(scope="module")
def server(tmp_path_factory: pytest.TempPathFactory, client_of: Callable[..., TestClient]) -> Iterator[dict[str, Any]]:
    """One server with a client for each of three roles."""
    services = build(Settings(data=tmp_path_factory.mktemp("data")))
    with client_of(services) as admin:
        viewer = client_of(services, name="vera", role="viewer")
        manager = client_of(services, name="carl", role="catalogue manager")
        yield {"admin": admin, "viewer": viewer, "manager": manager, "services": services}


def test_a_viewer_reads_every_number_with_its_unit_and_source(server: dict[str, Any]) -> None:
    """The list has the shipped instruments. Details give each camera number either a source or the reason of its
    choice.
    """
    listed = server["viewer"].get("/api/instruments").json()
    assert listed["unit"] == "cubestar"
    assert {i["name"] for i in listed["instruments"]} >= {"cubestar", "sunsat", "far_mst", "oersted", "aim"}
    assert all(i["origin"] == "shipped" and len(i["version"]) == 64 for i in listed["instruments"])
    shown = server["viewer"].get("/api/instruments/cubestar").json()
    assert shown["numbers"]
    assert all((n["source"] is None) != (n["chosen"] is None) for n in shown["numbers"])
    focal = next(n for n in shown["numbers"] if n["name"] == "focal_length")
    assert (focal["values"], focal["unit"], focal["source"]) == ([6.28], "mm", "Erlank 2013 §5.4, measured 6.28 mm")
    assert shown["link"]["baud"] == 115200
    assert server["viewer"].get("/api/instruments/unheard").status_code == 404


def test_a_package_with_mistakes_is_refused_with_file_line_and_field(server: dict[str, Any]) -> None:
    """Check and installation name file, line and field of the mistake. Nothing is installed."""
    broken = package("mine", ("camera.yaml", "value: 6.28, unit: mm", "value: 6.28, unit: cm"))
    report = upload(server["manager"], "/api/instruments/check", broken).json()
    assert not report["valid"]
    (problem,) = report["problems"]
    assert problem.startswith("camera.yaml, line 8: geometry.focal_length")
    assert "must be mm" in problem
    reply = upload(server["manager"], "/api/instruments", broken)
    assert reply.status_code == 422 or reply.status_code == 400
    assert "camera.yaml, line 8" in reply.json()["message"]
    names = [i["name"] for i in server["viewer"].get("/api/instruments").json()["instruments"]]
    assert "mine" not in names
    assert not list(server["services"].base.settings.instruments_folder.glob("mine*"))


def test_a_new_version_is_checked_compared_installed_and_exported(server: dict[str, Any]) -> None:
    """The second version replaces the first, which stays available for comparison. The export equals the uploaded
    package.
    """
    first, second = package("ours"), package("ours", ("camera.yaml", "value: 6.28", "value: 6.31"))
    assert upload(server["manager"], "/api/instruments", first).status_code == 201
    report = upload(server["manager"], "/api/instruments/check", second).json()
    assert report["valid"]
    assert report["replaces"]
    assert [d["file"] for d in report["differences"]] == ["camera.yaml"]
    added = upload(server["manager"], "/api/instruments", second).json()
    assert (added["origin"], added["version"]) == ("own", report["version"])
    shown = server["viewer"].get("/api/instruments/ours").json()
    assert shown["versions"] == [report["version"], report["replaces"]]
    query = {"old": f"ours@{report['replaces']}", "new": "ours"}
    (difference,) = server["viewer"].get("/api/instruments/diff", params=query).json()
    assert any(line.startswith("+") and "6.31" in line for line in difference["lines"])
    before = server["viewer"].get("/api/instruments/ours", params={"version": report["replaces"]}).json()
    assert next(n for n in before["numbers"] if n["name"] == "focal_length")["values"] == [6.28]
    data = server["viewer"].get("/api/instruments/ours/package.zip").content
    assert read_zip(data) == read_zip(second)


def test_a_shipped_name_and_a_viewer_are_refused(server: dict[str, Any]) -> None:
    """A shipped instrument cannot be replaced. Installation needs the permission. Every attempt is in the audit log."""
    assert upload(server["viewer"], "/api/instruments", package("theirs")).status_code == 403
    shipped = write_zip("cubestar", CUBESTAR)
    assert upload(server["manager"], "/api/instruments", shipped).status_code == 409
    assert not upload(server["manager"], "/api/instruments/check", shipped).json()["valid"]
    rows = server["admin"].get("/api/audit").json()
    rows = rows["rows"] if isinstance(rows, dict) else rows
    results = [(r["who"], r["result"]) for r in rows if "instruments" in f"{r['action']} {r['target']}"]
    assert ("vera", "denied") in results
    assert ("carl", "failed") in results


def test_an_archive_without_a_package_is_rejected(server: dict[str, Any]) -> None:
    """Random bytes, an archive with a path outside the folder and a zip bomb are rejected with a reason."""
    bomb = io.BytesIO()
    with zipfile.ZipFile(bomb, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("instrument.yaml", b"0" * (64 << 20))
    foreign = io.BytesIO()
    with zipfile.ZipFile(foreign, "w") as archive:
        archive.writestr("../evil.yaml", b"x: 1")
    for data in (b"no zip at all", bomb.getvalue(), foreign.getvalue()):
        assert upload(server["manager"], "/api/instruments/check", data).json()["problems"]
        assert upload(server["manager"], "/api/instruments", data).status_code in (400, 422)


def test_use_is_counted_by_version(server: dict[str, Any], tmp_path: Path) -> None:
    """Frames, contacts and catalogues count for the version that they name. Rows without a version count separately."""
    now, version = utc_now(), server["viewer"].get("/api/instruments/aim").json()["version"]
    frame = {"source": "import", "name": "f", "taken": now, "received": now, "columns": 8, "rows": 8, "bits": 8}
    frame |= {"dtype": "|u1", "sha256": "0" * 64, "rows_held": [], "parameters": {}}
    catalogue = {"name": "c", "format": "aim", "created": now, "author": "a", "stars": 1, "pairs": 1, "size": 1}
    catalogue |= {"sha256": "1" * 64, "request": {}, "manifest": {}, "report": {}}
    with server["services"].base.database.unit_of_work() as session:
        session.add(Frame(**frame, profile="aim", instrument_version=version))
        session.add(Frame(**frame, profile="aim"))
        session.add(Contact(url="x", started=now, ended=now, instrument="aim", instrument_version=version))
        session.add(Catalogue(**catalogue, profile="aim", instrument_version=version))
    shown = server["viewer"].get("/api/instruments/aim").json()
    assert shown["use"] == {"version": None, "frames": 2, "contacts": 1, "catalogues": 1}
    assert {"version": None, "frames": 1, "contacts": 0, "catalogues": 0} in shown["uses"]
    assert {"version": version, "frames": 1, "contacts": 1, "catalogues": 1} in shown["uses"]

"""External text, names and files: stored unchanged, served as data, and never used as a path, page or program.

Decompression bombs, pixel floods and body limits have separate tests: tests/operations/test_frame_files.py,
tests/catalogue_tools/test_hostile_star_lists.py, tests/api/test_api_guards.py.
"""

from __future__ import annotations

import ast
import re
from pathlib import Path
from urllib.parse import quote

import pytest
from fastapi.testclient import TestClient

SCRIPT = "<script>alert(1)</script><img src=x onerror=alert(1)>"
TRAVERSALS = [
    "../../../etc/passwd",
    "..%2f..%2f..%2fetc%2fpasswd",
    "....//....//etc/passwd",
    "/etc/passwd",
    "..\\..\\gss.db",
    "gss.db",
    "..%00.bin",
    "~/.ssh/id_rsa",
    "C:\\windows\\win.ini",
]
FILES = [
    "/api/contacts/1/captures/{}",
    "/api/rerun/{}",
    "/api/admin/backups/{}/file",
    "/help/{}",
    "/help/pictures/{}",
    "/assets/{}",
    "/{}",
]


@pytest.mark.parametrize("name", TRAVERSALS)
@pytest.mark.parametrize("template", FILES)
def test_no_name_in_an_address_leaves_its_folder(client: TestClient, template: str, name: str) -> None:
    """No address of captures, viewer files, backups, documents or pages returns another file of the host."""
    for address in (template.format(name), template.format(quote(name, safe=""))):
        reply = client.get(address)
        assert b"root:" not in reply.content
        assert not reply.content.startswith(b"SQLite format")
        assert "password_hash" not in reply.text
        assert reply.status_code < 500, address


@pytest.mark.parametrize("name", [*TRAVERSALS[:5], SCRIPT, "a\r\nX-Evil: 1", "\u202egnp.exe", "x" * 5000])
def test_the_name_of_an_uploaded_file_is_only_text(client: TestClient, name: str) -> None:
    """The name of an uploaded file creates no file and no header. The names of stored files are hashes."""
    folder: Path = client.app.state.services.base.settings.data  # type: ignore[attr-defined]
    before = {path.name for path in folder.parent.iterdir()}
    reply = client.post("/api/frames/import", files={"file": (name, b"not an image", "image/png")})
    assert reply.status_code in (400, 409, 413, 422), reply.text
    reply = client.post("/api/catalogues/sources", files={"file": (name, b"ra,dec,mag\n1,2,3\n", "text/csv")})
    assert reply.status_code < 500, reply.text
    assert "x-evil" not in reply.headers
    assert {path.name for path in folder.parent.iterdir()} == before
    stored = (
        [path.name for path in (folder / "blobs").rglob("*") if path.is_file()] if (folder / "blobs").exists() else []
    )
    assert all(set(stem) <= set("0123456789abcdef.") for stem in stored), stored


def test_a_script_in_a_procedure_stays_text(client: TestClient) -> None:
    """The text of a procedure is stored unchanged and returned as JSON, which browsers do not interpret as a page, with a
    policy that forbids inline scripts.
    """
    text = f"# {SCRIPT[:60]}\n\n{SCRIPT}\n\n## note: {SCRIPT}\n\n{SCRIPT}\n"
    stored = client.post("/api/procedures", json={"text": text})
    assert stored.status_code == 201, stored.text
    reply = client.get("/api/procedures")
    assert reply.json()["stored"][0]["text"] == text
    assert reply.headers["content-type"] == "application/json"
    assert reply.headers["x-content-type-options"] == "nosniff"
    policy = reply.headers["content-security-policy"]
    scripts = next(part for part in policy.split(";") if part.strip().startswith("script-src"))
    assert "'unsafe-inline'" not in scripts


def test_a_script_in_the_log_stays_text(client: TestClient) -> None:
    """The text of an event is stored unchanged and returned as JSON."""
    services = client.app.state.services  # type: ignore[attr-defined]
    services.base.bus.record("device", "watch", SCRIPT)
    reply = client.get("/api/events", params={"limit": 1000})
    assert SCRIPT in [event["text"] for event in reply.json()]
    assert reply.headers["content-type"] == "application/json"


def test_no_page_of_ours_writes_markup_from_data(root: Path) -> None:
    """The source of the pages does not use {@html}, innerHTML and similar ways to insert markup."""
    for path in (root / "web" / "src").rglob("*"):
        if path.suffix in (".ts", ".svelte"):
            text = path.read_text()
            assert not [word for word in ("{@html", "innerHTML", "outerHTML", "insertAdjacentHTML") if word in text], (
                path
            )


@pytest.mark.parametrize(
    ("path", "query"),
    [
        ("/api/telemetry/history", {"name": "mode", "start": "2026-01-01' OR 1=1 --", "end": "2026-01-02"}),
        ("/api/telemetry/history", {"name": "mode'; DROP TABLE users; --", "start": "2026-01-01", "end": "2026-01-02"}),
        ("/api/telemetry/packets", {"packet": "x' UNION SELECT name, password_hash FROM users --"}),
        ("/api/telemetry/packets", {"start": "1; DELETE FROM events"}),
        ("/api/commands", {"text": "%' OR '1'='1"}),
        ("/api/commands", {"user": "' OR 1=1 --", "name": "x'--"}),
        ("/api/commands.csv", {"source": "' UNION SELECT * FROM users --"}),
        ("/api/frames", {"mode": "' OR 1=1 --"}),
        ("/api/analyses", {"kind": "'; DROP TABLE users; --"}),
        ("/api/calibrations", {"profile": "' OR ''='"}),
    ],
)
def test_a_filter_is_a_value_and_never_sql(client: TestClient, path: str, query: dict[str, str]) -> None:
    """SQL in a filter gives no rows of another table, and all tables still exist."""
    reply = client.get(path, params=query)
    assert reply.status_code in (200, 400, 404, 422), reply.text
    assert "argon2" not in reply.text
    assert client.get("/api/users").json()[0]["name"] == "ann"


def test_exported_text_is_not_a_spreadsheet_formula(client: TestClient) -> None:
    """No cell of the exported audit log, which unauthenticated clients can write to, starts a formula."""
    headers = {"X-GSS": "1", "Cookie": ""}
    client.post("/api/session", json={"name": "=cmd|' /C calc'!A0", "password": "x"}, headers=headers)
    text = client.get("/api/audit/export", params={"format": "csv"}).text
    assert not [line for line in text.splitlines() for cell in line.split(",") if cell.startswith(("=", "+", "@"))]


def test_no_code_runs_text_as_a_program(root: Path) -> None:
    """The code uses no eval, exec, pickle, marshal, shelve, shell=True or os.system, and YAML only with a stated
    loader.
    """
    words = r"\b(eval|exec|__import__|pickle|marshal|shelve|dill|cloudpickle|shell|yaml|system|popen)\b"
    for path in (root / "gss").rglob("*.py"):
        if re.search(words, text := path.read_text()):
            for node in ast.walk(ast.parse(text)):
                assert not _runs_text(node), f"{path}:{getattr(node, 'lineno', 0)}"


def _runs_text(node: ast.AST) -> bool:
    if isinstance(node, ast.Import | ast.ImportFrom):
        names = {alias.name for alias in node.names} | {getattr(node, "module", None)}
        return bool(names & {"pickle", "marshal", "shelve", "dill", "cloudpickle"})
    if not isinstance(node, ast.Call):
        return False
    name = ast.unparse(node.func)
    if name == "yaml.load":
        return not any(
            "Loader" in ast.unparse(argument) for argument in [*node.args[1:], *(k.value for k in node.keywords)]
        )
    shell = any(k.arg == "shell" and ast.unparse(k.value) != "False" for k in node.keywords)
    return shell or name in (
        "eval",
        "exec",
        "__import__",
        "os.system",
        "os.popen",
        "yaml.unsafe_load",
        "yaml.full_load",
    )

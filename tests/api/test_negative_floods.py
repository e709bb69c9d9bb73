"""A flood or a limited token must not delay ABORT, block the server, fill the log, or create a token with more
permissions.
"""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient

from gss.operations.accounts.passwords import AT_ONCE, MAX_WAITING
from gss.store.audit import AuditFilter
from gss.wiring.services import Services

PASSWORD = "orion over the sea"
MARK = {"X-GSS": "1"}


@pytest.fixture(scope="module")
def app(app_of: Callable[..., FastAPI]) -> FastAPI:
    """A server with Élodie, an admin, and vic, a viewer."""
    return app_of({"Élodie": ("admin", PASSWORD), "vic": ("viewer", PASSWORD + " vic")})


@pytest.fixture
def services(app: FastAPI) -> Services:
    """Its services."""
    services: Services = app.state.services
    services.accounts.accounts.attempts._failures.clear()
    return services


def browser(app: FastAPI, address: str, headers: dict[str, str] | None = None) -> TestClient:
    """Return a browser at an address."""
    given = MARK | (headers or {})
    return TestClient(
        app, base_url="http://localhost", headers=given, raise_server_exceptions=False, client=(address, 1)
    )


def program(app: FastAPI, services: Services, name: str, role: str, scopes: list[str]) -> TestClient:
    """Return a client with a token that expires after a day."""
    owner = services.accounts.accounts.users.named("Élodie")
    assert owner is not None
    made = services.accounts.accounts.tokens.add(name, role, 1, by="test", owner_id=owner.id, scopes=scopes)
    return browser(app, "10.1.0.1", {"Authorization": f"Bearer {made.key}"})


def sign_in(client: TestClient, name: str, password: str) -> Any:
    """Sign in as the page does."""
    return client.post("/api/session", json={"name": name, "password": password})


def test_abort_does_not_wait_for_sign_ins_and_too_many_are_rejected(app: FastAPI, services: Services) -> None:
    """With every hashing slot in use, ABORT is answered and one more sign-in gets 429 at once."""
    go, turns = threading.Event(), services.accounts.accounts.passwords.turns
    held = [turns.take(lambda: go.wait(30)) for _ in range(AT_ONCE + MAX_WAITING)]
    try:
        client = program(app, services, "stop only", "viewer", ["stop"])
        reply = client.post("/api/commands/abort")
        assert reply.status_code not in (401, 403, 429), reply.text  # a token with scope stop only
        reply = sign_in(browser(app, "10.1.0.2"), "vic", PASSWORD + " vic")
        assert (reply.status_code, reply.headers["retry-after"]) == (429, "2")
    finally:
        go.set()
    assert all(turn.result(30) for turn in held)
    assert sign_in(browser(app, "10.1.0.2"), "vic", PASSWORD + " vic").status_code == 200


def test_a_body_is_not_read_without_permission(app: FastAPI, services: Services) -> None:
    """403 before length and form are checked; with permission a JSON body has at most 1 MiB, whatever its content type."""
    viewer = browser(app, "10.1.0.3")
    viewer.headers["X-GSS"] = sign_in(viewer, "vic", PASSWORD + " vic").json()["csrf"]
    big = b"[" + b"1," * (1 << 20) + b"1]"
    assert viewer.post("/api/users", content=b"{not json").status_code == 403
    assert viewer.post("/api/users", content=big).status_code == 403
    for kind in ("application/json", "multipart/form-data; boundary=x", ""):
        reply = viewer.post("/api/stacks/check", content=big, headers={"Content-Type": kind})
        assert (reply.status_code, "1024 KiB" in reply.json()["expected"]) == (413, True), kind
    files = {"file": ("a.png", b"x" * (2 << 20), "image/png")}
    assert program(app, services, "files", "admin", []).post("/api/frames/import", files=files).status_code == 400


@pytest.mark.parametrize("depth", [40, 900, 100_000])
def test_deeply_nested_json_is_a_bad_request(app: FastAPI, services: Services, depth: int) -> None:
    """At any depth."""
    client = program(app, services, f"deep {depth}", "admin", [])
    for body in (b"[" * depth + b"]" * depth, b'{"name":' + b"[" * depth + b"]" * depth + b"}"):
        reply = client.post("/api/commands/check", content=body, headers={"Content-Type": "application/json"})
        assert reply.status_code in (400, 422), reply.text


def test_a_name_is_found_in_any_case_of_any_alphabet(app: FastAPI, services: Services) -> None:
    """Signing in as typed, in lower case, and with a combining accent gives the same row."""
    for name in ("Élodie", "élodie", "ÉLODIE", "E\u0301lodie"):
        reply = sign_in(browser(app, "10.1.0.4"), name, PASSWORD)
        assert (reply.status_code, reply.json().get("name")) == (200, "Élodie"), name


def test_failed_sign_ins_are_one_audit_row_a_minute(app: FastAPI, services: Services) -> None:
    """For each address, whatever names are tried, and none for attempts rejected by the rate limit."""
    stranger = browser(app, "10.1.0.5")
    codes = [sign_in(stranger, name, "wrong").status_code for name in ["vic", "unknown user", *["vic"] * 6]]
    assert codes[0] == 401
    assert codes[-1] == 429
    rows = services.accounts.audit.page(AuditFilter(action="session.sign_in"), 100)
    assert [row.who for row in rows if row.address == "10.1.0.5"] == ["vic"]


def test_a_limited_token_creates_nothing_with_more_permissions_or_longer_life(app: FastAPI, services: Services) -> None:
    """No user, link, role or token beyond its own permissions, and none that outlives it."""
    narrow = program(app, services, "narrow", "admin", ["admin.users", "admin.tokens", "view", "metrics", "stop"])
    admin, vic = services.accounts.accounts.users.named("Élodie"), services.accounts.accounts.users.named("vic")
    assert admin is not None
    assert vic is not None
    refused = [
        narrow.post("/api/users", json={"name": "eve", "role": "admin"}),
        narrow.post(f"/api/users/{admin.id}/link"),
        narrow.put(f"/api/users/{admin.id}", json={"role": "viewer"}),
        narrow.put(f"/api/users/{vic.id}", json={"role": "operator"}),
        narrow.post("/api/tokens", json={"name": "wide", "role": "admin", "days": 0.5}),
    ]
    assert [reply.status_code for reply in refused] == [403] * len(refused)
    assert narrow.post("/api/tokens", json={"name": "long", "role": "viewer", "days": 2.0}).status_code == 400
    assert narrow.post("/api/tokens", json={"name": "short", "role": "viewer", "days": 0.5}).status_code == 201
    assert narrow.post("/api/users", json={"name": "may", "role": "viewer"}).status_code == 201

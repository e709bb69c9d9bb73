"""Floods of requests do not delay ABORT, block the server or fill the log. Limited tokens grant no more permissions."""

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
    """Server with the users Élodie, an admin, and vic, a viewer."""
    return app_of({"Élodie": ("admin", PASSWORD), "vic": ("viewer", PASSWORD + " vic")})


@pytest.fixture
def services(app: FastAPI) -> Services:
    """Services of the server, without counted failures of sign-in."""
    services: Services = app.state.services
    services.accounts.accounts.attempts._failures.clear()
    return services


def browser(app: FastAPI, address: str, headers: dict[str, str] | None = None) -> TestClient:
    """Return a client without a session at a network address."""
    all_headers = MARK | (headers or {})
    return TestClient(
        app, base_url="http://localhost", headers=all_headers, raise_server_exceptions=False, client=(address, 1)
    )


def token_client(app: FastAPI, services: Services, name: str, role: str, scopes: list[str]) -> TestClient:
    """Return a client with a token of Élodie that expires after a day."""
    owner = services.accounts.accounts.users.named("Élodie")
    assert owner is not None
    token = services.accounts.accounts.tokens.add(name, role, 1, by="test", owner_id=owner.id, scopes=scopes)
    return browser(app, "10.1.0.1", {"Authorization": f"Bearer {token.key}"})


def sign_in(client: TestClient, name: str, password: str) -> Any:
    """Sign in as the page does."""
    return client.post("/api/session", json={"name": name, "password": password})


def test_abort_does_not_wait_for_sign_ins_and_too_many_are_rejected(app: FastAPI, services: Services) -> None:
    """While every hashing slot is in use, ABORT is answered, and another sign-in is a 429 at once."""
    release, turns = threading.Event(), services.accounts.accounts.passwords.turns
    running = [turns.take(lambda: release.wait(30)) for _ in range(AT_ONCE + MAX_WAITING)]
    try:
        client = token_client(app, services, "stop only", "viewer", ["stop"])
        reply = client.post("/api/commands/abort")
        assert reply.status_code not in (401, 403, 429), reply.text  # a token with scope stop only
        reply = sign_in(browser(app, "10.1.0.2"), "vic", PASSWORD + " vic")
        assert (reply.status_code, reply.headers["retry-after"]) == (429, "2")
    finally:
        release.set()
    assert all(turn.result(30) for turn in running)
    assert sign_in(browser(app, "10.1.0.2"), "vic", PASSWORD + " vic").status_code == 200


def test_a_body_is_not_read_without_permission(app: FastAPI, services: Services) -> None:
    """Without permission the response is a 403, for any body. With permission a JSON body has at most 1 MiB."""
    viewer = browser(app, "10.1.0.3")
    viewer.headers["X-GSS"] = sign_in(viewer, "vic", PASSWORD + " vic").json()["csrf"]
    big = b"[" + b"1," * (1 << 20) + b"1]"
    assert viewer.post("/api/users", content=b"{not json").status_code == 403
    assert viewer.post("/api/users", content=big).status_code == 403
    for kind in ("application/json", "multipart/form-data; boundary=x", ""):
        reply = viewer.post("/api/procedures/check", content=big, headers={"Content-Type": kind})
        assert (reply.status_code, "1024 KiB" in reply.json()["expected"]) == (413, True), kind
    files = {"file": ("a.png", b"x" * (2 << 20), "image/png")}
    assert token_client(app, services, "files", "admin", []).post("/api/frames/import", files=files).status_code == 400


@pytest.mark.parametrize("depth", [40, 900, 100_000])
def test_deeply_nested_json_is_a_bad_request(app: FastAPI, services: Services, depth: int) -> None:
    """JSON that is nested to any depth is rejected as a bad request."""
    client = token_client(app, services, f"deep {depth}", "admin", [])
    for body in (b"[" * depth + b"]" * depth, b'{"name":' + b"[" * depth + b"]" * depth + b"}"):
        reply = client.post("/api/commands/check", content=body, headers={"Content-Type": "application/json"})
        assert reply.status_code in (400, 422), reply.text


def test_a_name_is_found_in_any_case_of_any_alphabet(app: FastAPI, services: Services) -> None:
    """Sign-in accepts the name as typed, in other cases and with a combining accent."""
    for name in ("Élodie", "élodie", "ÉLODIE", "E\u0301lodie"):
        reply = sign_in(browser(app, "10.1.0.4"), name, PASSWORD)
        assert (reply.status_code, reply.json().get("name")) == (200, "Élodie"), name


def test_failed_sign_ins_are_one_audit_row_a_minute(app: FastAPI, services: Services) -> None:
    """Failed sign-ins of an address give one audit row, for any names. Attempts over the rate limit give none."""
    anonymous = browser(app, "10.1.0.5")
    codes = [sign_in(anonymous, name, "wrong").status_code for name in ["vic", "unknown user", *["vic"] * 6]]
    assert codes[0] == 401
    assert codes[-1] == 429
    rows = services.accounts.audit.page(AuditFilter(action="session.sign_in"), 100)
    assert [row.who for row in rows if row.address == "10.1.0.5"] == ["vic"]


def test_a_limited_token_creates_nothing_with_more_permissions_or_longer_life(app: FastAPI, services: Services) -> None:
    """A limited token cannot create users, links, roles or tokens with more permissions, or tokens that expire
    later.
    """
    narrow = token_client(app, services, "narrow", "admin", ["admin.users", "admin.tokens", "view", "metrics", "stop"])
    admin, vic = services.accounts.accounts.users.named("Élodie"), services.accounts.accounts.users.named("vic")
    assert admin is not None
    assert vic is not None
    rejected = [
        narrow.post("/api/users", json={"name": "eve", "role": "admin"}),
        narrow.post(f"/api/users/{admin.id}/link"),
        narrow.put(f"/api/users/{admin.id}", json={"role": "viewer"}),
        narrow.put(f"/api/users/{vic.id}", json={"role": "operator"}),
        narrow.post("/api/tokens", json={"name": "wide", "role": "admin", "days": 0.5}),
    ]
    assert [reply.status_code for reply in rejected] == [403] * len(rejected)
    assert narrow.post("/api/tokens", json={"name": "long", "role": "viewer", "days": 2.0}).status_code == 400
    assert narrow.post("/api/tokens", json={"name": "short", "role": "viewer", "days": 0.5}).status_code == 201
    assert narrow.post("/api/users", json={"name": "may", "role": "viewer"}).status_code == 201

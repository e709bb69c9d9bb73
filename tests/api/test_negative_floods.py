"""What a flood or a narrow key must not do: hold ABORT up, freeze the server, fill the record, make a wider key."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient

from gss.operations.accounts.passwords import AT_ONCE, MOST_WAITING
from gss.store.audit import AuditFilter
from gss.wiring import Services

PASSWORD = "orion over the sea"
MARK = {"X-GSS": "1"}


@pytest.fixture(scope="module")
def app(app_of: Callable[..., FastAPI]) -> FastAPI:
    """A server with Élodie, an admin, and vic, a viewer."""
    return app_of({"Élodie": ("admin", PASSWORD), "vic": ("viewer", PASSWORD + " vic")})


@pytest.fixture
def services(app: FastAPI) -> Services:
    """Behind it."""
    services: Services = app.state.services
    services.accounts.attempts._failures.clear()
    return services


def browser(app: FastAPI, address: str, headers: dict[str, str] | None = None) -> TestClient:
    """Somebody at an address."""
    given = MARK | (headers or {})
    return TestClient(
        app, base_url="http://localhost", headers=given, raise_server_exceptions=False, client=(address, 1)
    )


def program(app: FastAPI, services: Services, name: str, role: str, scopes: list[str]) -> TestClient:
    """A token's bearer; the token lives for a day."""
    owner = services.accounts.users.named("Élodie")
    assert owner is not None
    made = services.accounts.tokens.add(name, role, 1, by="test", owner_id=owner.id, scopes=scopes)
    return browser(app, "10.1.0.1", {"Authorization": f"Bearer {made.key}"})


def sign_in(client: TestClient, name: str, password: str) -> Any:
    """As the page does."""
    return client.post("/api/session", json={"name": name, "password": password})


def test_abort_waits_for_no_sign_in_and_too_many_are_sent_away(app: FastAPI, services: Services) -> None:
    """With every place at the hashing taken, ABORT is answered and one more sign-in hears 429 at once."""
    go, turns = threading.Event(), services.accounts.passwords.turns
    held = [turns.take(lambda: go.wait(30)) for _ in range(AT_ONCE + MOST_WAITING)]
    try:
        client = program(app, services, "stop only", "viewer", ["stop"])
        reply = client.post("/api/commands/abort")
        assert reply.status_code not in (401, 403, 429), reply.text  # a token that may only stop
        reply = sign_in(browser(app, "10.1.0.2"), "vic", PASSWORD + " vic")
        assert (reply.status_code, reply.headers["retry-after"]) == (429, "2")
    finally:
        go.set()
    assert all(turn.result(30) for turn in held)
    assert sign_in(browser(app, "10.1.0.2"), "vic", PASSWORD + " vic").status_code == 200


def test_a_body_is_not_read_for_those_who_may_not(app: FastAPI, services: Services) -> None:
    """403 before the length and the form are looked at; and who may sends words of 1 MiB at most, whatever they call them."""
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
def test_brackets_in_brackets_are_a_bad_request(app: FastAPI, services: Services, depth: int) -> None:
    """However deep."""
    client = program(app, services, f"deep {depth}", "admin", [])
    for body in (b"[" * depth + b"]" * depth, b'{"name":' + b"[" * depth + b"]" * depth + b"}"):
        reply = client.post("/api/commands/check", content=body, headers={"Content-Type": "application/json"})
        assert reply.status_code in (400, 422), reply.text


def test_a_name_is_known_in_any_case_of_any_alphabet(app: FastAPI, services: Services) -> None:
    """Signing in as typed, in small letters, and with the accent apart; the row is the same."""
    for name in ("Élodie", "élodie", "ÉLODIE", "E\u0301lodie"):
        reply = sign_in(browser(app, "10.1.0.4"), name, PASSWORD)
        assert (reply.status_code, reply.json().get("name")) == (200, "Élodie"), name


def test_failed_sign_ins_are_one_row_a_minute(app: FastAPI, services: Services) -> None:
    """For each address, whatever names are tried, and none for those that a brake stopped."""
    stranger = browser(app, "10.1.0.5")
    codes = [sign_in(stranger, name, "wrong").status_code for name in ["vic", "nobody here", *["vic"] * 6]]
    assert codes[0] == 401
    assert codes[-1] == 429
    rows = services.audit.page(AuditFilter(action="session.sign_in"), 100)
    assert [row.who for row in rows if row.address == "10.1.0.5"] == ["vic"]


def test_a_narrow_token_makes_nothing_wider_or_longer(app: FastAPI, services: Services) -> None:
    """No user, link, role or token beyond its own permissions, and none that outlives it."""
    narrow = program(app, services, "narrow", "admin", ["admin.users", "admin.tokens", "view", "metrics", "stop"])
    admin, vic = services.accounts.users.named("Élodie"), services.accounts.users.named("vic")
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

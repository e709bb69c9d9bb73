"""Checking a one-time link when its page opens does not use it and reveals no more than using it."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient

from gss.operations.accounts.users import UserService
from gss.store.audit import AuditFilter
from gss.wiring.services import Services

PASSWORD = "capella over the roof"
CHECK = "/api/password-links/check"


@pytest.fixture
def services(app: FastAPI) -> Services:
    """A server whose rate limits are unused."""
    services: Services = app.state.services
    services.accounts.accounts.attempts._failures.clear()
    return services


@pytest.fixture
def anonymous(app: FastAPI, services: Services) -> TestClient:
    """A browser without a session."""
    assert services
    return TestClient(app, base_url="http://localhost", headers={"X-GSS": "1"}, client=("10.9.0.1", 5000))


def link_of(services: Services, name: str) -> str:
    """Return a new password link of a new user."""
    return services.accounts.accounts.users.password_link(
        services.accounts.accounts.users.add(name, "viewer", by="test").id, by="test"
    ).key


def test_checking_a_link_is_unlimited_and_does_not_use_it(services: Services, anonymous: TestClient) -> None:
    """Checking changes nothing, writes no row, and does not count as a failed attempt."""
    token = link_of(services, "fresh")
    rows = len(services.accounts.audit.page(AuditFilter(), 500))
    looks = [anonymous.post(CHECK, json={"kind": "password", "token": token}).status_code for _ in range(40)]
    assert looks == [204] * 40
    assert len(services.accounts.audit.page(AuditFilter(), 500)) == rows
    body = {"token": token, "password": PASSWORD}
    assert anonymous.post("/api/password-links", json=body).json()["name"] == "fresh"


def test_an_invalid_link_is_rejected_with_the_message_of_its_use(services: Services, anonymous: TestClient) -> None:
    """Used, for another purpose, replaced by a newer one, guessed: the response does not say which."""
    used, other = link_of(services, "used"), link_of(services, "other")
    anonymous.post("/api/password-links", json={"token": used, "password": PASSWORD})
    services.accounts.accounts.users.password_link(
        next(u.id for u in services.accounts.accounts.users.every() if u.name == "other"), by="test"
    )
    response = anonymous.post("/api/password-links", json={"token": used, "password": PASSWORD})
    tries = [("password", used), ("password", other), ("setup", other), ("password", "guess"), ("setup", "guess")]
    for kind, token in tries:
        reply = anonymous.post(CHECK, json={"kind": kind, "token": token})
        same = ("message", "expected", "hint")
        assert (reply.status_code, [reply.json()[k] for k in same]) == (403, [response.json()[k] for k in same]), kind


def test_guesses_share_the_rate_limit_of_the_use(services: Services, anonymous: TestClient) -> None:
    """One count for both: checking does not bypass the limit."""
    codes = [anonymous.post(CHECK, json={"kind": "password", "token": f"guess {k}"}).status_code for k in range(20)]
    assert set(codes) == {403, 429}
    body = {"token": link_of(services, "late"), "password": PASSWORD}
    assert anonymous.post("/api/password-links", json=body).status_code == 429


def test_a_setup_link_is_valid_until_the_first_user_exists(app_of: Callable[..., FastAPI]) -> None:
    """The printed link of an empty server; afterwards the same link is rejected though its hour has not ended."""
    app = app_of({})
    users: UserService = app.state.services.accounts.accounts.users
    anonymous = TestClient(app, base_url="http://localhost", headers={"X-GSS": "1"})
    link = users.set_up_link()
    assert link is not None
    body = {"kind": "setup", "token": link.key}
    assert anonymous.post(CHECK, json=body).status_code == 204
    users.add("first", "admin", by="shell", password=PASSWORD)
    assert anonymous.post(CHECK, json=body).status_code == 403

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
    """Services of the server, without counted failures of sign-in."""
    services: Services = app.state.services
    services.accounts.accounts.attempts._failures.clear()
    return services


@pytest.fixture
def anonymous(app: FastAPI, services: Services) -> TestClient:
    """Client without a session."""
    assert services
    return TestClient(app, base_url="http://localhost", headers={"X-GSS": "1"}, client=("10.9.0.1", 5000))


def new_link_key(services: Services, name: str) -> str:
    """Add a user and return the key of a new password link."""
    return services.accounts.accounts.users.password_link(
        services.accounts.accounts.users.add(name, "viewer", by="test").id, by="test"
    ).key


def test_checking_a_link_is_unlimited_and_does_not_use_it(services: Services, anonymous: TestClient) -> None:
    """A check does not use the link, writes no audit row, and does not count as a failed attempt."""
    token = new_link_key(services, "fresh")
    rows = len(services.accounts.audit.page(AuditFilter(), 500))
    statuses = [anonymous.post(CHECK, json={"kind": "password", "token": token}).status_code for _ in range(40)]
    assert statuses == [204] * 40
    assert len(services.accounts.audit.page(AuditFilter(), 500)) == rows
    body = {"token": token, "password": PASSWORD}
    assert anonymous.post("/api/password-links", json=body).json()["name"] == "fresh"


def test_an_invalid_link_is_rejected_with_the_message_of_its_use(services: Services, anonymous: TestClient) -> None:
    """The response is the same for used, replaced and guessed links and for links of another kind."""
    used, other = new_link_key(services, "used"), new_link_key(services, "other")
    anonymous.post("/api/password-links", json={"token": used, "password": PASSWORD})
    services.accounts.accounts.users.password_link(
        next(u.id for u in services.accounts.accounts.users.list_all() if u.name == "other"), by="test"
    )
    response = anonymous.post("/api/password-links", json={"token": used, "password": PASSWORD})
    links = [("password", used), ("password", other), ("setup", other), ("password", "guess"), ("setup", "guess")]
    for kind, token in links:
        reply = anonymous.post(CHECK, json={"kind": kind, "token": token})
        parts = ("message", "expected", "hint")
        assert (reply.status_code, [reply.json()[k] for k in parts]) == (403, [response.json()[k] for k in parts]), kind


def test_guesses_share_the_rate_limit_of_the_use(services: Services, anonymous: TestClient) -> None:
    """Checks and uses of links share a rate limit, so a check does not bypass it."""
    codes = [anonymous.post(CHECK, json={"kind": "password", "token": f"guess {k}"}).status_code for k in range(20)]
    assert set(codes) == {403, 429}
    body = {"token": new_link_key(services, "late"), "password": PASSWORD}
    assert anonymous.post("/api/password-links", json=body).status_code == 429


def test_a_setup_link_is_valid_until_the_first_user_exists(app_of: Callable[..., FastAPI]) -> None:
    """The setup link of an empty server is rejected after the first user was added, before it expires."""
    app = app_of({})
    users: UserService = app.state.services.accounts.accounts.users
    anonymous = TestClient(app, base_url="http://localhost", headers={"X-GSS": "1"})
    link = users.set_up_link()
    assert link is not None
    body = {"kind": "setup", "token": link.key}
    assert anonymous.post(CHECK, json=body).status_code == 204
    users.add("first", "admin", by="shell", password=PASSWORD)
    assert anonymous.post(CHECK, json=body).status_code == 403

"""Whether a one-time link still works is told when its page opens: no more than its use would tell, and without using it."""

from __future__ import annotations

from collections.abc import Callable

import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient

from gss.operations.accounts.users import UserService
from gss.store.audit import AuditFilter
from gss.wiring import Services

PASSWORD = "capella over the roof"
CHECK = "/api/password-links/check"


@pytest.fixture
def services(app: FastAPI) -> Services:
    """A server whose brake nobody has touched."""
    services: Services = app.state.services
    services.accounts.attempts._failures.clear()
    return services


@pytest.fixture
def stranger(app: FastAPI, services: Services) -> TestClient:
    """A browser of nobody."""
    assert services
    return TestClient(app, base_url="http://localhost", headers={"X-GSS": "1"}, client=("10.9.0.1", 5000))


def link_of(services: Services, name: str) -> str:
    """A fresh link for the password of a new user."""
    return services.accounts.users.password_link(services.accounts.users.add(name, "viewer", by="test").id).key


def test_a_fresh_link_is_good_as_often_as_one_looks_and_then_still_works_once(
    services: Services, stranger: TestClient
) -> None:
    """Looking uses nothing up, writes no row, and does not count as a failed try."""
    token = link_of(services, "fresh")
    rows = len(services.audit.page(AuditFilter(), 500))
    looks = [stranger.post(CHECK, json={"kind": "password", "token": token}).status_code for _ in range(40)]
    assert looks == [204] * 40
    assert len(services.audit.page(AuditFilter(), 500)) == rows
    body = {"token": token, "password": PASSWORD}
    assert stranger.post("/api/password-links", json=body).json()["name"] == "fresh"


def test_a_link_that_is_used_foreign_or_guessed_is_refused_in_the_words_of_its_use(
    services: Services, stranger: TestClient
) -> None:
    """Used, for another purpose, replaced by a newer one, guessed: nobody learns which."""
    used, other = link_of(services, "used"), link_of(services, "other")
    stranger.post("/api/password-links", json={"token": used, "password": PASSWORD})
    services.accounts.users.password_link(next(u.id for u in services.accounts.users.every() if u.name == "other"))
    told = stranger.post("/api/password-links", json={"token": used, "password": PASSWORD})
    tries = [("password", used), ("password", other), ("setup", other), ("password", "guess"), ("setup", "guess")]
    for kind, token in tries:
        reply = stranger.post(CHECK, json={"kind": kind, "token": token})
        same = ("message", "expected", "hint")
        assert (reply.status_code, [reply.json()[k] for k in same]) == (403, [told.json()[k] for k in same]), kind


def test_guesses_are_braked_together_with_those_at_the_use_itself(services: Services, stranger: TestClient) -> None:
    """One count for both: looking is no way round the brake."""
    codes = [stranger.post(CHECK, json={"kind": "password", "token": f"guess {k}"}).status_code for k in range(20)]
    assert set(codes) == {403, 429}
    body = {"token": link_of(services, "late"), "password": PASSWORD}
    assert stranger.post("/api/password-links", json=body).status_code == 429


def test_a_set_up_link_is_good_until_there_is_somebody(app_of: Callable[..., FastAPI]) -> None:
    """The printed link of an empty server; afterwards the same link is refused though its hour is not over."""
    app = app_of({})
    users: UserService = app.state.services.accounts.users
    stranger = TestClient(app, base_url="http://localhost", headers={"X-GSS": "1"})
    link = users.set_up_link()
    assert link is not None
    body = {"kind": "setup", "token": link.key}
    assert stranger.post(CHECK, json=body).status_code == 204
    users.add("first", "admin", by="shell", password=PASSWORD)
    assert stranger.post(CHECK, json=body).status_code == 403

"""Fixtures of API tests: the application runs in the test process, without a device."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path

import pytest
from fastapi import FastAPI
from fastapi.testclient import TestClient

from gss.api.app import create_app
from gss.operations.accounts.permissions import ROLES
from gss.settings import Settings
from gss.wiring.build import build
from gss.wiring.services import Services


@pytest.fixture(scope="session")
def client_of(signed_in: Callable[..., dict[str, str]]) -> Callable[..., TestClient]:
    """Factory of clients on which ann, an admin, is signed in, or a user with another ``name`` and ``role``."""

    def make(services: Services, name: str = "ann", role: str = "admin") -> TestClient:
        return TestClient(
            create_app(services),
            base_url="http://localhost",
            headers=signed_in(services, role, name),
            raise_server_exceptions=False,
        )

    return make


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory, client_of: Callable[..., TestClient]) -> Iterator[TestClient]:
    """Client of an admin."""
    folder: Path = tmp_path_factory.mktemp("data")
    with client_of(build(Settings(data=folder))) as client:
        yield client


@pytest.fixture(scope="module")
def app_of(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Callable[..., FastAPI]]:
    """Factory of started servers without a link. ``people``: role and password of each name; hashing is cheap."""
    with ExitStack() as running:

        def make(people: dict[str, tuple[str, str]]) -> FastAPI:
            settings = Settings(data=tmp_path_factory.mktemp("data"), password_memory_kib=8, password_passes=1)
            services = build(settings)
            for name, (role, password) in people.items():
                services.accounts.accounts.users.add(name, role, by="test", password=password)
            app = create_app(services)
            running.enter_context(TestClient(app))
            return app

        yield make


@pytest.fixture(scope="module")
def app(app_of: Callable[..., FastAPI]) -> FastAPI:
    """A server without a link and without users."""
    return app_of({})


@pytest.fixture(scope="module")
def clients(app: FastAPI, signed_in: Callable[..., dict[str, str]]) -> dict[str, TestClient]:
    """One browser for each role on that server; the browser with the key "" is not signed in."""
    headers_of = {role: signed_in(app.state.services, role, f"the {role}") for role in ROLES} | {"": {"X-GSS": "1"}}
    return {
        role: TestClient(app, base_url="http://localhost", headers=headers, raise_server_exceptions=False)
        for role, headers in headers_of.items()
    }

"""The application in this process, without a device."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from fastapi.testclient import TestClient

from gss.api.app import create_app
from gss.settings import Settings
from gss.wiring import Services, build


@pytest.fixture(scope="session")
def client_of(signed_in: Callable[..., dict[str, str]]) -> Callable[..., TestClient]:
    """Makes a client of services on which ann, an admin, is signed in; with another ``name`` and ``role`` somebody else."""

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
    """A client that may make changes."""
    folder: Path = tmp_path_factory.mktemp("data")
    with client_of(build(Settings(data=folder))) as client:
        yield client

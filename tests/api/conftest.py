"""The application in this process, without a device."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest
from fastapi.testclient import TestClient

from gss.api.app import create_app
from gss.settings import Settings
from gss.wiring import build

OPTIONS = {"base_url": "http://localhost", "headers": {"X-GSS": "1"}, "raise_server_exceptions": False}


@pytest.fixture(scope="module")
def client(tmp_path_factory: pytest.TempPathFactory) -> Iterator[TestClient]:
    """A client that may make changes."""
    folder: Path = tmp_path_factory.mktemp("data")
    with TestClient(create_app(build(Settings(data=folder))), **OPTIONS) as client:
        yield client

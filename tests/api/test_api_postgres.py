"""Hostile values for a server with PostgreSQL, which rejects values that SQLite stores: NUL, long texts, large numbers."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient
from sqlalchemy import create_engine, text

from gss.settings import Settings
from gss.wiring.build import build
from tools.hostile_texts import ATTEMPTED, STORED

pytestmark = [pytest.mark.postgres, pytest.mark.timeout(300)]
ENDLESS = ("/api/stream", "/api/rerun/live")
TEXTS = ("%00", "a%00b", "%25", "_", "%5C", "%27%3B--", "%F0%9F%9B%B0" * 60, "%ED%A0%80")
NUMBERS = ("0", "-1", "2147483647", "2147483648", "9223372036854775808", "9" * 60)
TIMES = (
    "0001-01-01T00:00:00%2B14:00",
    "9999-12-31T23:59:59-14:00",
    "2026-11-26T00:00:00%2B99:99",
    "2026-02-30T00:00:00Z",
    "-4714-01-01T00:00:00Z",
    "infinity",
)
WIDE = "\N{SATELLITE}"
"""A character of four bytes, so that a limit in characters and a limit in bytes differ."""


@pytest.fixture(scope="module")
def client(
    tmp_path_factory: pytest.TempPathFactory, postgres_url: str, client_of: Callable[..., TestClient]
) -> Iterator[TestClient]:
    """Client of an admin on a server with an empty PostgreSQL database."""
    engine = create_engine(postgres_url)
    with engine.begin() as connection:
        connection.execute(text("DROP SCHEMA public CASCADE"))
        connection.execute(text("CREATE SCHEMA public"))
    engine.dispose()
    folder: Path = tmp_path_factory.mktemp("data")
    with client_of(build(Settings(data=folder, database=postgres_url))) as client:
        yield client


@pytest.fixture(scope="module")
def schema(client: TestClient) -> Any:
    """The API's description."""
    return client.get("/api/openapi.json").json()


def values_of(parameter: Any) -> tuple[str, ...]:
    """Return hostile values for a parameter of the API, percent-encoded."""
    choices = [parameter["schema"], *parameter["schema"].get("anyOf", ()), parameter["schema"].get("items", {})]
    if any(choice.get("format") == "date-time" for choice in choices):
        return TIMES
    if any(choice.get("type") in ("integer", "number") for choice in choices):
        return NUMBERS
    return TEXTS if any(choice.get("type") == "string" for choice in choices) else ()


def test_hostile_values_of_every_query_are_rejected_or_harmless(client: TestClient, schema: Any) -> None:
    """Each parameter of each GET route gets NUL, wildcards, numbers beyond the columns and impossible times. The server
    answers each request and never with status 500.
    """
    failed, count = [], 0
    for path, operations in schema["paths"].items():
        operation = operations.get("get")
        if operation is None or path in ENDLESS:
            continue
        parameters = operation.get("parameters", [])
        defaults = {p["name"]: "1" for p in parameters if p["in"] == "path"}
        for parameter in parameters:
            for value in values_of(parameter):
                in_path = defaults | ({parameter["name"]: value} if parameter["in"] == "path" else {})
                query = f"?{parameter['name']}={value}" if parameter["in"] == "query" else ""
                status = client.get(path.format(**in_path) + query).status_code
                count += 1
                if status >= 500 and status != 503:
                    failed.append((path, parameter["name"], value[:40], status))
    assert failed == []
    assert count > 300, count


def longest(value: Any) -> Any:
    """Return a body whose texts with markup consist of wide characters instead, of the same length."""
    if isinstance(value, dict):
        return {key: longest(part) for key, part in value.items()}
    if isinstance(value, list):
        return [longest(part) for part in value]
    is_text = isinstance(value, str) and "injected" in value and not value.startswith("/")
    return WIDE * len(value) if is_text else value


@pytest.mark.parametrize("change", [lambda body: body, longest], ids=["markup", "wide characters"])
def test_hostile_texts_of_bodies_are_stored_or_rejected(client: TestClient, change: Callable[[Any], Any]) -> None:
    """Bodies with markup and with wide characters are stored or rejected, never with status 500."""
    for method, path, body in (*STORED, *ATTEMPTED):
        reply = client.request(method, "/api" + path.format(frame=1), json=change(body))
        assert reply.status_code < 500 or reply.status_code == 503, (path, reply.text)
    assert any(row["name"].startswith(('"', WIDE)) for row in client.get("/api/views").json())


@pytest.mark.parametrize("name", ["a\0b.png", WIDE * 200], ids=["NUL", "long"])
def test_hostile_names_of_files_are_stored_or_rejected(client: TestClient, name: str) -> None:
    """NUL and wide characters in the name of a file and in a field of a form are stored as text or rejected."""
    for path, data, fields in (
        ("/frames/import", b"P5 1 1 255 x", {"profile": name}),
        ("/catalogues/sources", b"ra,dec,mag\n1,2,3\n", {"name": name[:80]}),
        ("/catalogues/sources", b"ra,dec,mag\n1,2,3\n", {"name": "", "profile": name[:40]}),
        ("/lists", b"list,col_px,row_px,flux\n0,1,2,3\n", {"camera": "cubestar"}),
        ("/instruments", b"PK", {}),
        ("/attitudes/compare", b"CCSDS_AEM_VERS = 1.0\n", {"origin": "ground"}),
    ):
        reply = client.post("/api" + path, files={"file": (name, data)}, data=fields)
        assert reply.status_code < 500, (path, reply.text)

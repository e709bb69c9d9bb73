"""Databases for the tests: SQLite always, and PostgreSQL if its server program is installed."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from gss.store.engine import Database, open_engine
from gss.store.migration import migrate


@pytest.fixture(params=["sqlite", pytest.param("postgres", marks=pytest.mark.postgres)])
def database_url(request: pytest.FixtureRequest, tmp_path: Path) -> str:
    """URL of an empty database of each kind."""
    if request.param == "sqlite":
        return f"sqlite:///{tmp_path / 'gss.db'}"
    from sqlalchemy import text

    url: str = request.getfixturevalue("postgres_url")
    engine = open_engine(url)
    with engine.begin() as connection:
        connection.execute(text("DROP SCHEMA public CASCADE"))
        connection.execute(text("CREATE SCHEMA public"))
    engine.dispose()
    return url


@pytest.fixture
def database(database_url: str) -> Iterator[Database]:
    """Database with the newest schema."""
    migrate(database_url)
    database = Database(open_engine(database_url))
    yield database
    database.close()

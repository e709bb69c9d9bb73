"""Database with the newest schema for each test, migrated once and copied."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from gss.store.engine import Database, open_engine
from gss.store.migration import migrate


@pytest.fixture(scope="session")
def migrated_file(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Database file to copy."""
    path: Path = tmp_path_factory.mktemp("migrated") / "gss.db"
    migrate(f"sqlite:///{path}")
    return path


@pytest.fixture
def database(migrated_file: Path, tmp_path: Path) -> Iterator[Database]:
    """SQLite database with the newest schema."""
    database = Database(open_engine(f"sqlite:///{shutil.copy(migrated_file, tmp_path / 'gss.db')}"))
    yield database
    database.close()

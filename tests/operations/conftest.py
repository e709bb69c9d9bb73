"""A migrated database with a bus, and clocks that tests turn by hand."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from gss.operations.events import EventBus
from gss.store.engine import Database, migrate, open_engine


class HandClock:
    """A clock that only moves when told."""

    def __init__(self) -> None:
        self.at = datetime(2026, 12, 1, 18, 0, tzinfo=UTC)

    def __call__(self) -> datetime:
        return self.at

    def forward(self, seconds: float) -> None:
        self.at += timedelta(seconds=seconds)


@pytest.fixture
def clock() -> HandClock:
    """The hand clock."""
    return HandClock()


@pytest.fixture
def database(tmp_path: Path) -> Iterator[Database]:
    """An SQLite database at the newest schema."""
    url = f"sqlite:///{tmp_path / 'gss.db'}"
    migrate(url)
    database = Database(open_engine(url))
    yield database
    database.close()


@pytest.fixture
def bus(database: Database, clock: HandClock) -> EventBus:
    """The bus on that database."""
    return EventBus(database, clock)

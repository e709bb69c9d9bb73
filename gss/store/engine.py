"""The database: opening it, bringing it to the newest schema, one transaction at a time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from alembic import command
from alembic.config import Config
from sqlalchemy import Engine, create_engine, event
from sqlalchemy.exc import DatabaseError, OperationalError
from sqlalchemy.orm import Session, sessionmaker

from gss.domain.errors import CorruptData, StoreDown

SHIPPED = Path(__file__).parent.parent / "migrations"
CHECKOUT = Path(__file__).parent.parent.parent / "migrations"


def open_engine(url: str) -> Engine:
    """Engine for an SQLite or PostgreSQL URL. SQLite gets write-ahead logging, so that readers never wait for the writer."""
    if not url.startswith("sqlite"):
        return create_engine(url, pool_pre_ping=True)
    engine = create_engine(url, connect_args={"check_same_thread": False})
    event.listen(engine, "connect", _tune_sqlite)
    return engine


def _tune_sqlite(connection: Any, _record: Any) -> None:
    cursor = connection.cursor()
    for pragma in ("journal_mode=WAL", "synchronous=NORMAL", "busy_timeout=5000", "foreign_keys=ON"):
        cursor.execute(f"PRAGMA {pragma}")
    cursor.close()


def migrate(url: str) -> None:
    """Upgrade the database to the newest schema; nothing happens where it is there already."""
    config = Config()
    config.set_main_option("script_location", str(SHIPPED if SHIPPED.is_dir() else CHECKOUT))
    config.set_main_option("sqlalchemy.url", url.replace("%", "%%"))
    try:
        command.upgrade(config, "head")
    except DatabaseError as error:
        hint = "restore it from a backup, or give another folder with --data"
        raise CorruptData("the database cannot be opened", got=str(error.orig), hint=hint) from error


class Database:
    """Sessions on one engine. Rows stay readable after their transaction has ended."""

    def __init__(self, engine: Engine) -> None:
        self.engine = engine
        self._sessions = sessionmaker(engine, expire_on_commit=False)

    @contextmanager
    def unit_of_work(self) -> Iterator[Session]:
        """A session that commits at the end, or rolls back when something is raised."""
        try:
            with self._sessions.begin() as session:
                yield session
        except (OperationalError, OverflowError) as error:
            cause = str(getattr(error, "orig", error))
            raise StoreDown(
                "the database cannot be used now", got=cause, hint="look at disk space and locks"
            ) from error

    def close(self) -> None:
        """Give back all connections."""
        self.engine.dispose()

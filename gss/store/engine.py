"""The database: opening it, bringing it to the newest schema, one transaction at a time."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from alembic import command
from alembic.config import Config
from sqlalchemy import Engine, create_engine, event, func, select
from sqlalchemy.exc import ArgumentError, DatabaseError, NoSuchModuleError, OperationalError
from sqlalchemy.orm import Session, sessionmaker

from gss.domain.errors import BadInput, Conflict, CorruptData, StoreDown

SHIPPED = Path(__file__).parent.parent / "migrations"
CHECKOUT = Path(__file__).parent.parent.parent / "migrations"


def open_engine(url: str) -> Engine:
    """Engine for an SQLite or PostgreSQL URL. SQLite gets write-ahead logging, so that readers never wait for the writer."""
    try:
        if not url.startswith("sqlite"):
            return create_engine(url, pool_pre_ping=True)
    except (ArgumentError, NoSuchModuleError, ImportError) as error:
        # The text of the error may hold the URL, and that one a password.
        raise BadInput(
            "the database's URL cannot be used",
            expected="postgresql+psycopg://user:password@host/database, or sqlite:///file",
            got=type(error).__name__,
            hint="GSS_DATABASE; pip install 'gss-startracker[postgres]'",
        ) from None
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
        if not url.startswith("sqlite"):
            cause = str(error.orig).strip().splitlines()[0]
            raise StoreDown(
                "the database server cannot be used", got=cause, hint="look at the server and at GSS_DATABASE"
            ) from None
        hint = "restore it from a backup, or give another folder with --data"
        raise CorruptData("the database cannot be opened", got=str(error.orig), hint=hint) from error


SERVER_LOCK = 0x6773_7301
"""Key of PostgreSQL's advisory lock that a server holds while it runs."""


@contextmanager
def sole_server(url: str) -> Iterator[None]:
    """While it is entered no other server runs on this PostgreSQL database, whatever its data folder; Conflict where one does.
    An SQLite database lies in the data folder, which has a lock of its own. A server that dies gives the lock back."""
    if url.startswith("sqlite"):
        yield
        return
    engine = open_engine(url)
    try:
        with engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
            if not connection.scalar(select(func.pg_try_advisory_lock(SERVER_LOCK))):
                raise Conflict(
                    "another server runs on this database",
                    expected="one server",
                    hint="stop it, or use another database",
                )
            yield
    except OperationalError as error:
        cause = str(error.orig).strip().splitlines()[0]
        raise StoreDown(
            "the database server cannot be used", got=cause, hint="look at the server and at GSS_DATABASE"
        ) from None
    finally:
        engine.dispose()


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

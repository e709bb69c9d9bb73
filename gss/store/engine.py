"""The database: connection, schema migration and transactions."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import quote

from alembic import command
from alembic.config import Config
from alembic.runtime.migration import MigrationContext
from alembic.script import ScriptDirectory
from alembic.util import CommandError
from sqlalchemy import Connection, Engine, create_engine, event, func, inspect, make_url, select
from sqlalchemy.exc import ArgumentError, DatabaseError, NoSuchModuleError, OperationalError
from sqlalchemy.orm import Session, sessionmaker

from gss.domain.errors import BadInput, Conflict, CorruptData, StoreDown
from gss.store.models import Base

QUICK_CHECK_BYTES = 512 << 20
MAX_WAL_BYTES = 64 << 20
"""A write-ahead log that a long read made larger is cut to this size once it has been merged into the database."""
DAMAGED_HINT = (
    "stop the server and keep the folder unchanged; run `gss check store` for details and `gss restore` to restore a backup; "
    "the raw captures hold data received since"
)
SHIPPED = Path(__file__).parent.parent / "migrations"
CHECKOUT = Path(__file__).parent.parent.parent / "migrations"


def open_engine(url: str) -> Engine:
    """Return an engine for an SQLite or PostgreSQL URL. SQLite uses write-ahead logging, so that readers never wait for
    the writer. BadInput if the URL cannot be used."""
    try:
        if not url.startswith("sqlite"):
            return create_engine(url, pool_pre_ping=True)
    except (ArgumentError, NoSuchModuleError, ImportError) as error:
        # The error text may contain the URL, and thereby a password.
        raise BadInput(
            "the database's URL cannot be used",
            expected="postgresql+psycopg://user:password@host/database, or sqlite:///file",
            got=type(error).__name__,
            hint="GSS_DATABASE; pip install 'gss-startracker[postgres]'",
        ) from None
    engine = create_engine(url, connect_args={"check_same_thread": False})
    event.listen(engine, "connect", _tune_sqlite)
    event.listen(engine, "checkout", _sync_each_commit)
    return engine


def open_to_check(url: str) -> Engine:
    """Return an engine for reading only, also from a folder that cannot be written. BadInput if a file there needs its
    write-ahead log."""
    path = Path(url.removeprefix("sqlite:///"))
    if not url.startswith("sqlite:///") or os.access(path.parent, os.W_OK, effective_ids=True) or not path.exists():
        return open_engine(url)
    ahead = path.with_name(f"{path.name}-wal")
    if ahead.exists() and ahead.stat().st_size:
        raise BadInput(
            "the newest changes of this database are in its write-ahead log, which cannot be read in a read-only folder",
            got=str(ahead),
            hint="copy the folder to a disk that can be written, and check the copy",
        )
    return create_engine(f"sqlite:///file:{quote(str(path))}?immutable=1&uri=true")


def _tune_sqlite(connection: Any, _record: Any) -> None:
    cursor = connection.cursor()
    limit = f"journal_size_limit={MAX_WAL_BYTES}"
    for pragma in ("journal_mode=WAL", limit, "busy_timeout=5000", "foreign_keys=ON"):
        cursor.execute(f"PRAGMA {pragma}")
    cursor.close()


def _sync_each_commit(connection: Any, _record: Any, _proxy: Any) -> None:
    connection.execute("PRAGMA synchronous=FULL")


def open_for_migration(url: str) -> Engine:
    """Return an engine whose transactions include schema changes: if the server is killed midway, the old schema stays
    intact. SQLite alters a table by copying it, which its foreign key checks would treat as deletions, so they are off."""
    engine = open_engine(url)
    if url.startswith("sqlite"):
        event.listen(engine, "connect", _hold_schema)
        event.listen(engine, "begin", _begin)
    return engine


def _hold_schema(connection: Any, _record: Any) -> None:
    connection.isolation_level = None  # otherwise the driver commits before each schema change
    connection.execute("PRAGMA foreign_keys=OFF")


def _begin(connection: Connection) -> None:
    connection.exec_driver_sql("BEGIN IMMEDIATE")


def migration_config(url: str) -> Config:
    """Return Alembic's configuration: the folder of the migrations, and the URL."""
    config = Config()
    config.set_main_option("script_location", str(SHIPPED if SHIPPED.is_dir() else CHECKOUT))
    config.set_main_option("sqlalchemy.url", url.replace("%", "%%"))
    return config


def known_schemas() -> list[str]:
    """Return the revisions of all schemas that this version knows, oldest first."""
    return [step.revision for step in ScriptDirectory.from_config(migration_config("")).walk_revisions()][::-1]


def migrate(url: str) -> None:
    """Upgrade the database to the newest schema, if needed. An empty database gets it directly, in one transaction.

    Raises CorruptData if its file is damaged or its schema is newer, StoreDown if PostgreSQL cannot be used.
    """
    config = migration_config(url)
    _check_pages(url)
    try:
        if not _create_if_empty(url, config):
            command.upgrade(config, "head")
    except CommandError as error:
        raise CorruptData(
            "the database was written by a newer version",
            expected=f"a schema up to {known_schemas()[-1]}",
            got=str(error),
            hint="start the newer version again, or restore a backup made before it: gss restore",
        ) from error
    except DatabaseError as error:
        if not url.startswith("sqlite"):
            cause = str(error.orig).strip().splitlines()[0]
            raise StoreDown(
                "the database server cannot be used", got=cause, hint="check the server and GSS_DATABASE"
            ) from None
        raise CorruptData("the database cannot be opened", got=str(error.orig), hint=DAMAGED_HINT) from error


def _create_if_empty(url: str, config: Config) -> bool:
    """Create the newest schema from the models if the database has no tables. True if it was created."""
    engine = open_for_migration(url)
    try:
        with engine.begin() as connection:
            if inspect(connection).get_table_names():
                return False
            Base.metadata.create_all(connection)
            MigrationContext.configure(connection).stamp(ScriptDirectory.from_config(config), "head")
            return True
    finally:
        engine.dispose()


def _check_pages(url: str) -> None:
    """Check an SQLite file's pages before anything is written, if the file is small enough to take only a second or two."""
    path = Path(make_url(url).database or "")
    if not url.startswith("sqlite") or not path.is_file() or path.stat().st_size > QUICK_CHECK_BYTES:
        return
    engine = open_engine(url)
    try:
        damaged = damaged_pages(engine)
    finally:
        engine.dispose()
    if damaged:
        raise CorruptData("the database is damaged", got=damaged, hint=DAMAGED_HINT)


def is_large(engine: Engine) -> bool:
    """True if this is an SQLite file too large for the check at startup."""
    path = Path(engine.url.database or "")
    return engine.dialect.name == "sqlite" and path.is_file() and path.stat().st_size > QUICK_CHECK_BYTES


def damaged_pages(engine: Engine) -> str:
    """Return what is wrong with the pages of an SQLite file; "" if nothing is. StoreDown if it cannot be read now."""
    try:
        with engine.connect() as connection:
            problems = [str(row[0]) for row in connection.exec_driver_sql("PRAGMA quick_check(3)")]
    except OperationalError as error:
        raise StoreDown(
            "the database cannot be opened", got=str(error.orig), hint="check disk space and file locks"
        ) from error
    except DatabaseError as error:
        problems = [str(error.orig)]
    return "" if problems == ["ok"] else "; ".join(problems)[:300]


SERVER_LOCK = 0x6773_7301
"""Key of the PostgreSQL advisory lock that a server holds while it runs."""


@contextmanager
def sole_server(url: str) -> Iterator[None]:
    """Hold an exclusive lock on this database, whatever the data folder; Conflict if another server holds it. The lock
    is released if the server dies."""
    if url.startswith("sqlite"):
        with _sole_file(make_url(url).database or ""):
            yield
        return
    engine = open_engine(url)
    try:
        with engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
            if not connection.scalar(select(func.pg_try_advisory_lock(SERVER_LOCK))):
                raise _second_server()
            yield
    except OperationalError as error:
        cause = str(error.orig).strip().splitlines()[0]
        raise StoreDown(
            "the database server cannot be used", got=cause, hint="check the server and GSS_DATABASE"
        ) from None
    finally:
        engine.dispose()


@contextmanager
def _sole_file(name: str) -> Iterator[None]:
    """Hold the lock for an SQLite file, as a lock on a separate file beside it: SQLite uses its own locks on the database file."""
    if not name or name == ":memory:":
        yield
        return
    path = Path(name).resolve()
    try:
        file = path.with_name(f"{path.name}.server").open("w")
    except OSError as error:
        raise StoreDown("the database's folder cannot be written", got=str(error)) from error
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise _second_server(str(path)) from None
        yield


def _second_server(got: str = "") -> Conflict:
    return Conflict(
        "another server runs on this database", expected="one server", got=got, hint="stop it, or use another database"
    )


def _is_damage(error: DatabaseError) -> bool:
    """True if SQLite reports a damaged page; its other errors have their own classes."""
    return type(error.orig).__name__ == "DatabaseError" and any(
        phrase in str(error.orig) for phrase in ("malformed", "not a database")
    )


Transaction = Session
"""Type of an open unit of work, for code outside the store that passes it on."""


class Database:
    """Sessions on one engine. Rows stay readable after their transaction has ended."""

    def __init__(self, engine: Engine) -> None:
        self.engine = engine
        self.damage = ""
        """Last error about a damaged page; "" if there was none."""
        self._sessions = sessionmaker(engine, expire_on_commit=False)

    def report_damage(self, damage: str) -> None:
        """Remember a damaged page for :attr:`damage`."""
        self.damage = damage

    @contextmanager
    def unit_of_work(self, *, durable: bool = True) -> Iterator[Session]:
        """Open a session that commits at the end, or rolls back on an exception. StoreDown or CorruptData if the database fails.
        A ``durable`` commit has reached the disk when it returns; others reach it with the next durable one."""
        try:
            with self._sessions.begin() as session:
                if not durable and self.engine.dialect.name == "sqlite":
                    session.connection().exec_driver_sql("PRAGMA synchronous=NORMAL")
                yield session
        except (OperationalError, OverflowError) as error:
            cause = str(getattr(error, "orig", error))
            raise StoreDown("the database cannot be used", got=cause, hint="check disk space and file locks") from error
        except DatabaseError as error:
            if not _is_damage(error):
                raise
            self.report_damage(str(error.orig))
            raise CorruptData("the database is damaged", got=self.damage, hint=DAMAGED_HINT) from error

    def close(self) -> None:
        """Close all connections."""
        self.engine.dispose()

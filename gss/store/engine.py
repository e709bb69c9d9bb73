"""Connection, schema migration and transactions of the database."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any
from urllib.parse import quote

from sqlalchemy import Engine, create_engine, event, func, make_url, select
from sqlalchemy.exc import (
    ArgumentError,
    DatabaseError,
    DataError,
    IntegrityError,
    NoSuchModuleError,
    OperationalError,
)
from sqlalchemy.exc import TimeoutError as PoolTimeout
from sqlalchemy.orm import Session, sessionmaker

from gss.domain.errors import BadInput, Conflict, CorruptData, StoreDown

QUICK_CHECK_BYTES = 512 << 20
LOCK_WAIT_MS = 5000
"""Longest wait for a lock of another transaction, on both databases."""
MAX_WAL_BYTES = 64 << 20
"""Size to which the write-ahead log is cut after it has been merged into the database. A long read can make the log
larger."""
DAMAGED_HINT = (
    "stop the server and keep the folder unchanged; run `gss check store` for details and `gss restore` to restore a backup; "
    "the raw captures contain data received after the backup"
)


def open_engine(url: str) -> Engine:
    """Return an engine for an SQLite or PostgreSQL URL. SQLite uses write-ahead logging, so that readers never wait
    for the writer. With PostgreSQL, statements wait at most LOCK_WAIT_MS for a lock. Raises BadInput if the URL cannot
    be used."""
    try:
        if not url.startswith("sqlite"):
            engine = create_engine(url, pool_pre_ping=True)
            event.listen(engine, "connect", _limit_lock_wait)
            return engine
    except (ArgumentError, NoSuchModuleError, ImportError) as error:
        # The error text can contain the URL with a password.
        raise BadInput(
            "the database's URL cannot be used",
            expected="postgresql+psycopg://user:password@host/database, or sqlite:///file",
            got=type(error).__name__,
            hint="check GSS_DATABASE; for PostgreSQL run pip install 'gss-startracker[postgres]'",
        ) from None
    engine = create_engine(url, connect_args={"check_same_thread": False})
    event.listen(engine, "connect", _tune_sqlite)
    event.listen(engine, "checkout", _sync_each_commit)
    return engine


def open_to_check(url: str) -> Engine:
    """Return a read-only engine, which also works in a read-only folder. Raises BadInput if the database in a read-only
    folder needs its write-ahead log."""
    path = Path(url.removeprefix("sqlite:///"))
    if not url.startswith("sqlite:///") or os.access(path.parent, os.W_OK, effective_ids=True) or not path.exists():
        return open_engine(url)
    wal_path = path.with_name(f"{path.name}-wal")
    if wal_path.exists() and wal_path.stat().st_size:
        raise BadInput(
            "the newest changes of this database are in its write-ahead log, which cannot be read in a read-only folder",
            got=str(wal_path),
            hint="copy the folder to a writable disk, and check the copy",
        )
    return create_engine(f"sqlite:///file:{quote(str(path))}?immutable=1&uri=true")


def _limit_lock_wait(connection: Any, _record: Any) -> None:
    """Limit the wait for locks, for example of VACUUM FULL by an administrator."""
    with connection.cursor() as cursor:
        cursor.execute(f"SET lock_timeout = {LOCK_WAIT_MS}")
    connection.commit()


def _tune_sqlite(connection: Any, _record: Any) -> None:
    cursor = connection.cursor()
    limit = f"journal_size_limit={MAX_WAL_BYTES}"
    for pragma in ("journal_mode=WAL", limit, f"busy_timeout={LOCK_WAIT_MS}", "foreign_keys=ON"):
        cursor.execute(f"PRAGMA {pragma}")
    cursor.close()


def _sync_each_commit(connection: Any, _record: Any, _proxy: Any) -> None:
    connection.execute("PRAGMA synchronous=FULL")


def is_large(engine: Engine) -> bool:
    """True if the database is an SQLite file that is too large for the check at startup."""
    path = Path(engine.url.database or "")
    return engine.dialect.name == "sqlite" and path.is_file() and path.stat().st_size > QUICK_CHECK_BYTES


def damaged_pages(engine: Engine) -> str:
    """Return the problems of the pages of an SQLite file; "" if there are none. Raises StoreDown if the file cannot be
    read."""
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
"""Key of the PostgreSQL advisory lock that a running server holds."""


@contextmanager
def sole_server(url: str) -> Iterator[None]:
    """Hold an exclusive lock on the database, independent of the data folder. Raises Conflict if another server holds
    the lock. The lock is released if the server dies."""
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
    """Hold the lock for an SQLite database. It is a lock on a separate file, because SQLite uses locks on the database
    file."""
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
    """True if SQLite reports a damaged page. Other SQLite errors have other classes."""
    return type(error.orig).__name__ == "DatabaseError" and any(
        phrase in str(error.orig) for phrase in ("malformed", "not a database")
    )


def _is_concurrent(error: IntegrityError) -> bool:
    """True for a unique value or a reference, which a concurrent transaction can violate. Other constraints do not
    depend on other transactions, so a violation is a defect."""
    text = str(error.orig).lower()
    return any(kind in text for kind in ("unique constraint", "foreign key constraint"))


Transaction = Session
"""Type of an open unit of work, for code outside the store."""


class Database:
    """Database sessions on one engine. Rows remain readable after the end of their transaction."""

    def __init__(self, engine: Engine) -> None:
        self.engine = engine
        self.damage = ""
        """Last error about a damaged page; "" if there was none."""
        self._sessions = sessionmaker(engine, expire_on_commit=False)

    def report_damage(self, damage: str) -> None:
        """Set :attr:`damage` to the error about a damaged page."""
        self.damage = damage

    @contextmanager
    def unit_of_work(self, *, durable: bool = True) -> Iterator[Session]:
        """Open a session that commits at the end, or rolls back on an exception. Raises StoreDown or CorruptData if the
        database fails, BadInput for a value that its columns cannot hold, and Conflict if a concurrent transaction
        stored the same unique value or removed a row that this one refers to. A ``durable`` commit is flushed to the
        disk before the block ends; other commits are flushed with the next durable commit."""
        try:
            with self._sessions.begin() as session:
                if not durable and self.engine.dialect.name == "sqlite":
                    session.connection().exec_driver_sql("PRAGMA synchronous=NORMAL")
                yield session
        except (OperationalError, PoolTimeout) as error:
            cause = str(getattr(error, "orig", error))
            raise StoreDown("the database cannot be used", got=cause, hint="check disk space and file locks") from error
        except (DataError, OverflowError) as error:
            raise BadInput(
                "the database cannot store a value",
                expected="text without NUL, and numbers and lengths within the limits of the columns",
                got=str(getattr(error, "orig", error)).strip().splitlines()[0],
            ) from error
        except IntegrityError as error:
            if not _is_concurrent(error):
                raise
            raise Conflict(
                "another request changed the same data at the same time",
                got=str(error.orig).strip().splitlines()[0],
                hint="load the data again and repeat the request",
            ) from error
        except DatabaseError as error:
            if not _is_damage(error):
                raise
            self.report_damage(str(error.orig))
            raise CorruptData("the database is damaged", got=self.damage, hint=DAMAGED_HINT) from error

    def close(self) -> None:
        """Close all connections."""
        self.engine.dispose()

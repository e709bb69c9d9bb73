"""Create and restore a consistent copy of a database in use.

SQLite: ``VACUUM INTO`` copies a snapshot while other connections continue to read and write. PostgreSQL: ``pg_dump``
and ``psql`` must be installed. The password is passed in the environment, never on the command line.
"""

from __future__ import annotations

import os
import shutil
import sqlite3
import subprocess
from collections.abc import Callable
from pathlib import Path

from sqlalchemy import URL, inspect, make_url

from gss.domain.callbacks import never
from gss.domain.errors import Conflict, CorruptData, NotFound, StoreDown
from gss.store.engine import open_engine

CANCEL_CHECK_STEPS = 10_000
"""Number of SQLite virtual-machine steps between two checks for cancellation."""
SQLITE, POSTGRES = "sqlite", "postgresql"
QUERY_VARIABLES = (
    "PGHOST",
    "PGPORT",
    "PGUSER",
    "PGPASSWORD",
    "PGPASSFILE",
    "PGSSLMODE",
    "PGSSLROOTCERT",
    "PGSSLCERT",
    "PGSSLKEY",
)


def kind_of(url: str) -> str:
    """Return the database type of a URL: sqlite or postgresql."""
    return SQLITE if url.startswith("sqlite") else POSTGRES


def dump(url: str, file: Path, cancelled: Callable[[], bool] = never) -> None:
    """Copy the database to a new file. Raises StoreDown if the database or the disk fails, and deletes the partial
    file."""
    try:
        if kind_of(url) == SQLITE:
            _copy_sqlite(Path(make_url(url).database or ""), file, cancelled)
        else:
            _run("pg_dump", url, ["--no-owner", "--no-privileges", "--file", str(file)])
    except BaseException:  # includes KeyboardInterrupt: an interrupted dump must not leave a partial copy
        file.unlink(missing_ok=True)
        raise


def _copy_sqlite(source: Path, file: Path, cancelled: Callable[[], bool]) -> None:
    if not source.is_file():
        raise NotFound("there is no database", got=str(source))
    connection = sqlite3.connect(source, timeout=30)
    try:
        connection.set_progress_handler(lambda: int(cancelled()), CANCEL_CHECK_STEPS)
        connection.execute("VACUUM INTO ?", (str(file),))
    except sqlite3.DatabaseError as error:
        if "interrupted" in str(error):
            return
        is_operational = isinstance(error, sqlite3.OperationalError)
        text, hint = "the database cannot be copied", "run gss check store for details"
        raise (StoreDown if is_operational else CorruptData)(text, got=str(error), hint=hint) from error
    finally:
        connection.close()
    with file.open("r+b") as copy:
        os.fsync(copy.fileno())


def load(url: str, file: Path) -> None:
    """Restore a dump into an empty PostgreSQL database. Raises Conflict if the database has tables."""
    engine = open_engine(url)
    try:
        tables = inspect(engine).get_table_names()
    finally:
        engine.dispose()
    if tables:
        raise Conflict("the database is not empty", expected="an empty database", got=f"{len(tables)} tables")
    _run("psql", url, ["--quiet", "--single-transaction", "--set", "ON_ERROR_STOP=1", "--file", str(file)])


def _run(program: str, url: str, arguments: list[str]) -> None:
    path = shutil.which(program)
    if path is None:
        raise StoreDown(
            f"{program}, which copies a PostgreSQL database, is not installed",
            expected=program,
            hint="run apt install postgresql-client, or use the database server's own backup",
        )
    parsed = make_url(url)
    result = subprocess.run(  # noqa: S603 - absolute path of the program, no shell
        [path, *arguments], env={**os.environ, **_environment(parsed)}, capture_output=True, text=True, check=False
    )
    if result.returncode:
        cause = (result.stderr.strip().splitlines() or ["no error message"])[-1]
        raise StoreDown(f"{program} failed", got=cause, hint="check the database server")


def _environment(url: URL) -> dict[str, str]:
    """Return the libpq environment variables, including socket and encryption options from the URL's query."""
    parts: dict[str, object] = {name: url.query.get(name.removeprefix("PG").lower()) for name in QUERY_VARIABLES}
    connection_variables = {
        "PGHOST": url.host,
        "PGPORT": url.port,
        "PGUSER": url.username,
        "PGPASSWORD": url.password,
        "PGDATABASE": url.database,
    }
    parts |= {name: value for name, value in connection_variables.items() if value}
    return {name: str(value) for name, value in parts.items() if value}

"""Upgrade of the database to the newest schema.

Alembic is imported only when a schema has to be changed, because its import takes 0.2 s and 9 MB of each server.
"""

from __future__ import annotations

import sqlite3
from pathlib import Path
from typing import TYPE_CHECKING, Any

from sqlalchemy import (
    Column,
    Connection,
    Engine,
    MetaData,
    PrimaryKeyConstraint,
    String,
    Table,
    event,
    inspect,
    make_url,
    select,
)
from sqlalchemy.exc import DatabaseError

from gss.domain.errors import CorruptData, StoreDown
from gss.domain.words import counted
from gss.store.engine import DAMAGED_HINT, damaged_pages, is_large, open_engine
from gss.store.models import Base

if TYPE_CHECKING:
    from alembic.config import Config

SHIPPED = Path(__file__).parent.parent / "migrations"
CHECKOUT = Path(__file__).parent.parent.parent / "migrations"
VERSION = Table(
    "alembic_version",
    MetaData(),
    Column("version_num", String(32), nullable=False),
    PrimaryKeyConstraint("version_num", name="alembic_version_pkc"),
)
"""Alembic's table, with one row: the revision of the schema."""
OTHER_HINTS = {
    sqlite3.SQLITE_BUSY: "another program holds the database; end it and start again",
    sqlite3.SQLITE_READONLY: "make the database file and its folder writable",
    sqlite3.SQLITE_CANTOPEN: "check that the file and its folder exist and can be read and written",
    sqlite3.SQLITE_FULL: "free space on the disk",
}
"""Hints for failures of SQLite that are not damage, by error code."""


def migrations_folder() -> Path:
    """Return the folder of the migrations, in the installed package or in a checkout."""
    return SHIPPED if SHIPPED.is_dir() else CHECKOUT


def known_schemas() -> list[str]:
    """Return the revisions of all schemas that this version supports, oldest first: the first four characters of the names
    of the migrations."""
    return sorted(path.name[:4] for path in (migrations_folder() / "versions").glob("[0-9]*.py"))


def migration_config(url: str) -> Config:
    """Return Alembic's configuration: the folder of the migrations, and the URL."""
    from alembic.config import Config

    config = Config()
    config.set_main_option("script_location", str(migrations_folder()))
    config.set_main_option("sqlalchemy.url", url.replace("%", "%%"))
    return config


def open_for_migration(url: str) -> Engine:
    """Return an engine whose transactions include schema changes, so that the old schema stays intact if the server is
    killed during a migration. In SQLite, foreign key checks are off. SQLite alters a table by copying it, and the
    checks would treat this as a deletion of its rows."""
    engine = open_engine(url)
    if url.startswith("sqlite"):
        event.listen(engine, "connect", _enable_schema_transactions)
        event.listen(engine, "begin", _begin)
    return engine


def _enable_schema_transactions(connection: Any, _record: Any) -> None:
    connection.isolation_level = None  # by default, the driver commits before each schema change
    connection.execute("PRAGMA foreign_keys=OFF")


def _begin(connection: Connection) -> None:
    connection.exec_driver_sql("BEGIN IMMEDIATE")


def migrate(url: str) -> None:
    """Upgrade the database to the newest schema if needed. In an empty database the newest schema is created directly.

    Raises CorruptData if the file is damaged or the schema is newer than this version, StoreDown if PostgreSQL is not
    available.
    """
    _check_pages(url)
    try:
        revision = _revision_or_create(url)
        if revision not in known_schemas():
            raise CorruptData(
                "the database was written by a newer version",
                expected=f"a schema up to {known_schemas()[-1]}",
                got=f"schema {revision[:32]!a}",
                hint="start the newer version again, or restore a backup made before it: gss restore",
            )
        if revision != known_schemas()[-1]:
            from alembic import command

            command.upgrade(migration_config(url), "head")
    except DatabaseError as error:
        if not url.startswith("sqlite"):
            cause = str(error.orig).strip().splitlines()[0]
            raise StoreDown(
                "the database server cannot be used", got=cause, hint="check the server and GSS_DATABASE"
            ) from None
        code = getattr(error.orig, "sqlite_errorcode", 0) & 0xFF
        if code in OTHER_HINTS:
            raise StoreDown("the database cannot be opened", got=str(error.orig), hint=OTHER_HINTS[code]) from error
        raise CorruptData("the database cannot be opened", got=str(error.orig), hint=DAMAGED_HINT) from error


def _revision_or_create(url: str) -> str:
    """Return the revision of the schema. If the database has no tables, create the newest schema from the models. Raises
    CorruptData if it has tables and not exactly one revision: it belongs to another program, or it was changed by hand."""
    engine = open_for_migration(url)
    try:
        with engine.begin() as connection:
            tables = inspect(connection).get_table_names()
            if not tables:
                Base.metadata.create_all(connection)
                VERSION.create(connection)
                connection.execute(VERSION.insert().values(version_num=known_schemas()[-1]))
                return known_schemas()[-1]
            revisions = connection.scalars(select(VERSION.c.version_num)).all() if VERSION.name in tables else []
            if len(revisions) != 1:
                raise CorruptData(
                    "the database is not one of GSS, or its schema is not known",
                    expected="an empty database, or a table alembic_version with one row",
                    got=f"tables {', '.join(sorted(tables)[:5])}; {counted(len(revisions), 'revision')}",
                    hint="state another database with GSS_DATABASE or another folder with --data, or restore a backup",
                )
            return str(revisions[0])
    finally:
        engine.dispose()


def _check_pages(url: str) -> None:
    """Check the pages of an SQLite file before the first write, if the file is small enough for a check of at most two
    seconds."""
    if not url.startswith("sqlite") or not Path(make_url(url).database or "").is_file():
        return
    engine = open_engine(url)
    try:
        damaged = "" if is_large(engine) else damaged_pages(engine)
    finally:
        engine.dispose()
    if damaged:
        raise CorruptData("the database is damaged", got=damaged, hint=DAMAGED_HINT)

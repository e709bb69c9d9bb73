"""Data of the first schema are preserved by the migration to the newest one."""

from __future__ import annotations

import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest
from alembic import command
from alembic.config import Config
from alembic.script import ScriptDirectory
from sqlalchemy import text

from gss.domain.errors import CorruptData, StoreDown
from gss.store import engine
from gss.store.engine import Database, open_engine
from gss.store.migration import CHECKOUT, known_schemas, migrate, migration_config
from gss.store.models import Contact, Transfer

STARTED = "2026-01-02 03:04:05.000000"


def test_rows_of_the_first_schema_are_read_by_the_newest(tmp_path: Path) -> None:
    """A contact and a transfer stored with schema 0001 are migrated, with default values in the new columns."""
    url = f"sqlite:///{tmp_path / 'old.db'}"
    config = Config()
    config.set_main_option("script_location", str(CHECKOUT))
    config.set_main_option("sqlalchemy.url", url)
    command.upgrade(config, "0001")
    database = Database(open_engine(url))
    with database.unit_of_work() as session:
        session.execute(
            text(
                "INSERT INTO contacts (id, url, started, rx_bytes, tx_bytes, capture) VALUES (1, 'x', :at, 1, 2, 'c')"
            ),
            {"at": STARTED},
        )
        session.execute(
            text(
                "INSERT INTO transfers (id, contact_id, direction, kind, target, subject, state, reason, size, chunk_size, "
                "stored, resent, sha256, created, log) VALUES (1, 1, 'down', 'frame', '0', 's', 'verified', '', 9, 9, "
                "'[]', 0, '', :at, '[]')"
            ),
            {"at": STARTED},
        )
    migrate(url)
    with database.unit_of_work() as session:
        contact, transfer = session.get_one(Contact, 1), session.get_one(Transfer, 1)
        assert (contact.captures, contact.note, contact.rx_bytes) == ([], "", 1)
        assert (transfer.options, transfer.table_id, transfer.state) == ({}, None, "verified")
    database.close()


def test_a_start_with_the_newest_schema_does_not_import_alembic(tmp_path: Path) -> None:
    """Creating a database and opening it again changes no schema, so Alembic's memory and time are not spent."""
    program = (
        "import sys; from gss.store.migration import migrate; migrate(sys.argv[1]); migrate(sys.argv[1]); "
        "print('alembic' in sys.modules)"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, f"sqlite:///{tmp_path / 'new.db'}"], capture_output=True, text=True, check=True
    )
    assert done.stdout.strip() == "False"


def test_every_migration_is_named_by_its_revision() -> None:
    """The names of the files, which give the known schemas, agree with Alembic's chain of revisions."""
    steps = ScriptDirectory.from_config(migration_config("")).walk_revisions()
    assert known_schemas() == [step.revision for step in steps][::-1]


@pytest.mark.parametrize(
    "change",
    [
        "DROP TABLE alembic_version",
        "DELETE FROM alembic_version",
        "INSERT INTO alembic_version VALUES ('0001')",
    ],
)
def test_a_database_without_exactly_one_revision_is_not_changed(tmp_path: Path, change: str) -> None:
    """It was changed by hand, or it belongs to another program; the message says what is expected."""
    file = tmp_path / "gss.db"
    migrate(f"sqlite:///{file}")
    with closing(sqlite3.connect(file)) as connection:
        connection.execute(change)
        connection.commit()
        before = list(connection.iterdump())
        with pytest.raises(CorruptData, match="schema is not known") as problem:
            migrate(f"sqlite:///{file}")
        assert "with one row" in problem.value.expected
        assert list(connection.iterdump()) == before


def test_a_database_of_another_program_is_not_changed(tmp_path: Path) -> None:
    """No table is added to it."""
    file = tmp_path / "customers.db"
    with closing(sqlite3.connect(file)) as connection:
        connection.execute("CREATE TABLE customers (name)")
        with pytest.raises(CorruptData, match="not one of GSS"):
            migrate(f"sqlite:///{file}")
        assert connection.execute("SELECT name FROM sqlite_master").fetchall() == [("customers",)]


def test_a_locked_database_is_not_called_damaged(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The hint names the other program, not a backup."""
    file = tmp_path / "gss.db"
    migrate(f"sqlite:///{file}")
    monkeypatch.setattr(engine, "LOCK_WAIT_MS", 10)
    with closing(sqlite3.connect(file, isolation_level=None)) as connection:
        connection.execute("BEGIN IMMEDIATE")
        with pytest.raises(StoreDown) as problem:
            migrate(f"sqlite:///{file}")
    assert "another program" in problem.value.hint

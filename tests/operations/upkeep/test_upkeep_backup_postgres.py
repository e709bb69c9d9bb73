"""A backup of a PostgreSQL database is a dump, which is restored completely into an empty database."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from sqlalchemy import make_url, select, text
from sqlalchemy.exc import DatabaseError

from gss.domain.errors import BadInput, Conflict, StoreDown
from gss.operations.accounts.audit import AuditService
from gss.operations.accounts.audit_anchor import ANCHORS, AnchorFile
from gss.operations.upkeep.check_store import check_store
from gss.operations.upkeep.restore import NEW_IDS, restore
from gss.store import commands
from gss.store.blobs import BlobStore
from gss.store.engine import Database, open_engine
from gss.store.migration import migrate
from gss.store.models import Frame, SignIn, User

pytestmark = [pytest.mark.postgres, pytest.mark.timeout(120)]
PASSWORD = "never-to-be-logged"


@pytest.fixture
def urls(postgres_url: str) -> Iterator[tuple[str, str]]:
    """Two empty databases of one server."""
    names = ("gss_source", "gss_target")
    engine = open_engine(postgres_url)
    with engine.connect().execution_options(isolation_level="AUTOCOMMIT") as connection:
        for name in names:
            connection.execute(text(f"DROP DATABASE IF EXISTS {name} WITH (FORCE)"))
            connection.execute(text(f"CREATE DATABASE {name}"))
        database_urls = [make_url(postgres_url).set(database=name, password=PASSWORD) for name in names]
        yield (
            database_urls[0].render_as_string(hide_password=False),
            database_urls[1].render_as_string(hide_password=False),
        )
        for name in names:
            connection.execute(text(f"DROP DATABASE {name} WITH (FORCE)"))
    engine.dispose()


@pytest.fixture
def database(urls: tuple[str, str]) -> Iterator[Database]:
    """First of the two databases, with the newest schema."""
    migrate(urls[0])
    database = Database(open_engine(urls[0]))
    yield database
    database.close()


@pytest.fixture
def filled(store: Any, urls: tuple[str, str], clock: Any, tmp_path: Path) -> Any:
    """Store of the backup tests with this database, with an audit entry and an active session."""
    store.backups._url = urls[0]
    store.fill()
    store.add_packets("housekeeping", 5, age_days=1, every_s=1.0, request_id=0xFFFF_FFFE)
    audit = AuditService(store.database, clock, AnchorFile(tmp_path / "anchors"))
    audit.record("ann", "POST /x", "frame 1", "done", "äöü 'quoted' \\ back")
    with store.database.unit_of_work() as session:
        users = {"enabled": True, "password_hash": "", "created": clock(), "created_by": "test"}
        user = User(name="ann", role="admin", **users)
        session.add(user)
        session.flush()
        times = {"created": clock(), "last_seen": clock(), "expires": clock(), "end_reason": ""}
        session.add(SignIn(user_id=user.id, key_hash="k", address="", agent="", **times))
    return store


def content(database: Database) -> dict[str, list[Any]]:
    """Return every row of every table except those that a restore changes intentionally."""
    changed = {"choices", "commands", "sign_ins", "one_time_links", "api_tokens"}
    rows = {}
    with database.unit_of_work() as session:
        tables = "SELECT tablename FROM pg_tables WHERE schemaname = 'public' ORDER BY 1"
        for (name,) in session.execute(text(tables)).all():
            if name not in changed:
                rows[name] = sorted(str(tuple(row)) for row in session.execute(text(f"SELECT * FROM {name}")))  # noqa: S608
    return rows


def test_a_postgresql_database_is_restored_completely(
    filled: Any, urls: tuple[str, str], clock: Any, tmp_path: Path
) -> None:
    """Rows, blobs, captures, counters and the audit log's triggers are restored. Sessions are ended, and command ids
    restart at a higher number."""
    made = filled.backups.make()
    folder = tmp_path / "backups" / made.name
    assert (made.kind, made.database) == ("postgresql", "gss.sql")
    assert PASSWORD not in "".join(p.read_text() for p in folder.iterdir())
    with pytest.raises(BadInput, match="PostgreSQL"):
        restore(folder, tmp_path / "new", clock)
    before = content(filled.database)
    restore(folder, tmp_path / "new", clock, database_url=urls[1])
    database = Database(open_engine(urls[1]))
    after = content(database)
    (accepted,) = [row for row in after["audit"] if row not in before["audit"]]
    assert f"restored from backup {made.name}" in accepted
    assert after | {"audit": before["audit"]} == before
    assert len(before["telemetry_packets"]) == 5
    assert not (tmp_path / "new" / "gss.db").exists()
    blobs = BlobStore(str(tmp_path / "new" / "blobs"))
    audit = AuditService(database, clock, AnchorFile(tmp_path / "new" / ANCHORS))
    assert check_store(database, blobs, tmp_path / "new" / "captures", audit).whole
    with database.unit_of_work() as session:
        assert commands.last_request_id(session) == NEW_IDS
        assert [row.end_reason for row in session.scalars(select(SignIn))] == ["restored from a backup"]
        newest = max(f.id for f in session.scalars(select(Frame)))
    with pytest.raises(DatabaseError, match="append-only"), database.unit_of_work() as session:
        session.execute(text("DELETE FROM audit"))
    with database.unit_of_work() as session:
        old = session.get(Frame, newest)
        columns = {c.name: getattr(old, c.name) for c in Frame.__table__.columns if c.name != "id"}
        copied = Frame(**columns)
        session.add(copied)
        session.flush()
        assert copied.id == newest + 1
    database.close()
    with pytest.raises(Conflict, match="not empty"):
        restore(folder, tmp_path / "other", clock, database_url=urls[1])
    assert not (tmp_path / "other").exists()


def test_an_unreachable_server_leaves_no_backup_and_no_password(filled: Any, tmp_path: Path) -> None:
    """If the server is unreachable, its message is reported without the password, and the partial backup is removed."""
    url = make_url(filled.backups._url).set(port=1)
    filled.backups._url = url.render_as_string(hide_password=False)
    with pytest.raises(StoreDown, match="pg_dump failed") as refused:
        filled.backups.make()
    assert PASSWORD not in str(refused.value)
    assert filled.backups.list_all() == []


def test_a_socket_and_encryption_in_the_url_apply_to_the_dump_too(
    filled: Any,
) -> None:
    """A dump uses the address in the URL's query, as for a Unix socket, and its setting for encryption."""
    url = make_url(filled.backups._url)
    port = str(url.port)
    by_query = url.set(host=None, port=None).update_query_dict({"host": str(url.host), "port": port})
    filled.backups._url = by_query.render_as_string(hide_password=False)
    assert filled.backups.make().kind == "postgresql"
    filled.backups._url = by_query.update_query_dict({"sslmode": "require"}).render_as_string(hide_password=False)
    with pytest.raises(StoreDown, match="SSL"):
        filled.backups.make()

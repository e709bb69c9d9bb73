"""The audit record on both databases: it grows, and does nothing else."""

from __future__ import annotations

import csv
import json
import threading
from datetime import UTC, datetime

import pytest
from sqlalchemy import text, update
from sqlalchemy.exc import DBAPIError

from gss.operations.accounts.audit import FIELDS, AuditService, hash_of
from gss.store.audit import AuditFilter, add, last
from gss.store.models import AuditRow


def now() -> datetime:
    return datetime(2026, 12, 1, 18, 0, 0, 123456, tzinfo=UTC)


@pytest.fixture
def audit(database) -> AuditService:
    """A record with five rows."""
    service = AuditService(database, now)
    for number in range(5):
        service.record("ann", "link.open_link", f"/link/{number}", "done", role="operator", address="127.0.0.1")
    return service


@pytest.mark.parametrize(
    "statement",
    ["UPDATE audit SET who = 'eve' WHERE seq = 2", "DELETE FROM audit", "DELETE FROM audit WHERE seq = 5"],
)
def test_the_database_itself_refuses_to_change_or_remove_a_row(audit, database, statement):
    """Whatever program asks."""
    with pytest.raises(DBAPIError, match="append-only"), database.engine.begin() as connection:
        connection.execute(text(statement))
    assert audit.verify().problem == ""
    assert audit.verify().rows == 5


def test_a_row_cannot_be_replaced_in_passing_either(audit, database):
    """SQLite's INSERT OR REPLACE and PostgreSQL's TRUNCATE would go past the triggers on rows."""
    sqlite = database.engine.dialect.name == "sqlite"
    replace = "INSERT OR REPLACE INTO audit SELECT seq, at, 'eve', role, action, target, result, detail, address, previous, hash"
    with pytest.raises(DBAPIError, match="append-only"), database.engine.begin() as connection:
        connection.execute(text(f"{replace} FROM audit WHERE seq = 2" if sqlite else "TRUNCATE audit"))
    assert audit.verify().problem == ""


@pytest.mark.parametrize(
    ("statement", "problem"),
    [
        ("UPDATE audit SET who = 'eve' WHERE seq = 2", "row 2 was changed"),
        ("UPDATE audit SET result = 'denied', hash = previous WHERE seq = 3", "row 3 was changed"),
        ("DELETE FROM audit WHERE seq IN (2, 3)", "rows 2 to 3 are missing"),
        ("DELETE FROM audit WHERE seq = 1", "rows 1 to 1 are missing"),
    ],
)
def test_who_takes_the_triggers_away_leaves_a_trace(audit, database, statement, problem):
    """The chain of hashes shows which row."""
    with database.engine.begin() as connection:
        if database.engine.dialect.name == "sqlite":
            connection.execute(text("DROP TRIGGER audit_no_update"))
            connection.execute(text("DROP TRIGGER audit_no_delete"))
        else:
            connection.execute(text("DROP TRIGGER audit_no_change ON audit"))
        connection.execute(text(statement))
    assert audit.verify().problem == problem


def test_a_row_before_the_first_one_shows(audit, database):
    """Nothing refuses it, and nothing that follows names it: it is counted."""
    copy = "INSERT INTO audit SELECT -1, at, 'eve', role, action, target, result, detail, address, 'nothing', hash"
    with database.engine.begin() as connection:
        connection.execute(text(f"{copy} FROM audit WHERE seq = 2"))
    assert audit.verify().problem == "rows before the first one: 1"


def test_a_cut_end_shows_against_a_hash_noted_elsewhere(audit, database):
    """The chain alone cannot tell it; the last hash of an earlier export can."""
    noted = audit.verify().last_hash
    with database.engine.begin() as connection:
        sqlite = database.engine.dialect.name == "sqlite"
        connection.execute(text("DROP TRIGGER audit_no_delete" if sqlite else "DROP TRIGGER audit_no_change ON audit"))
        connection.execute(text("DELETE FROM audit WHERE seq = 5"))
    assert "does not refuse changes" in audit.verify().problem
    assert "cut off" in audit.verify(noted).problem


def test_a_guard_that_was_taken_away_is_missed(audit, database):
    """Dropped, switched off, or put back in a form that refuses nothing: the record is not what it was, even while no row was
    changed yet."""
    sqlite = database.engine.dialect.name == "sqlite"
    assert audit.verify().problem == ""
    weak = "CREATE TRIGGER audit_no_delete BEFORE DELETE ON audit BEGIN SELECT 1; END"
    never = "CREATE TRIGGER audit_no_delete BEFORE DELETE ON audit WHEN 0 BEGIN SELECT RAISE(ABORT, 'no'); END"
    steps = [["DROP TRIGGER audit_no_delete"], [weak], ["DROP TRIGGER audit_no_delete", never]]
    if not sqlite:
        steps = [["ALTER TABLE audit DISABLE TRIGGER audit_no_change"], ["DROP TRIGGER audit_no_change ON audit"]]
    for step in steps:
        with database.engine.begin() as connection:
            for statement in step:
                connection.execute(text(statement))
        name = "audit_no_delete" if sqlite else "audit_no_change"
        assert audit.verify().problem == f"the database does not refuse changes of the record any more: {name}"


def test_the_hash_holds_the_whole_time_and_older_rows_still_verify(audit, database):
    """A row of before has milliseconds in its hash and stays whole; of a new one not even a microsecond can be changed."""
    sqlite = database.engine.dialect.name == "sqlite"
    with database.unit_of_work() as session:
        older = AuditRow(**{f: getattr(last(session), f) for f in FIELDS})
    older.seq, older.previous = 6, older.hash
    older.hash = hash_of(older, "milliseconds")
    with database.unit_of_work() as session:
        add(session, older)
    assert hash_of(older) != older.hash
    audit.record("ann", "x.y", "after", "done")
    assert (audit.verify().problem, audit.verify().rows) == ("", 7)
    with database.engine.begin() as connection:
        connection.execute(text("DROP TRIGGER audit_no_update" if sqlite else "DROP TRIGGER audit_no_change ON audit"))
        later = now().replace(microsecond=123457)
        connection.execute(update(AuditRow).where(AuditRow.seq == 7).values(at=later))
    assert audit.verify().problem == "row 7 was changed"


def test_several_writers_make_one_chain(database):
    """Two services as two processes would have them, four threads: every row is there once, each follows the one before."""
    services = [AuditService(database, now) for _ in range(2)]

    def write(number: int) -> None:
        for row in range(10):
            services[number % 2].record(f"w{number}", "x.y", str(row), "done")

    threads = [threading.Thread(target=write, args=(number,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    verdict = services[0].verify()
    assert (verdict.problem, verdict.rows) == ("", 40)
    assert {(row.who, row.target) for row in services[0].page(AuditFilter(), 100)} == {
        (f"w{w}", str(r)) for w in range(4) for r in range(10)
    }


def test_the_record_is_filtered_paged_and_exported(audit):
    """Newest first on the page, oldest first in a file; text from outside cannot forge a line or a formula."""
    audit.record("=HYPERLINK(1)", "session.sign_in", "a\nb\x1b[2J", "denied", "x" * 5000)
    assert [row.seq for row in audit.page(AuditFilter(), 2)] == [6, 5]
    assert [row.seq for row in audit.page(AuditFilter(action="link."), 2, before=5)] == [4, 3]
    assert [row.seq for row in audit.page(AuditFilter(result="denied"), 9)] == [6]
    assert audit.page(AuditFilter(who="ann' OR 1=1 --"), 9) == []
    lines = [json.loads(line) for line in audit.export("jsonl")]
    assert [line["seq"] for line in lines] == [1, 2, 3, 4, 5, 6]
    assert lines[5]["target"] == "a�b�[2J"
    assert len(lines[5]["detail"]) == 2000
    rows = list(csv.DictReader(audit.export("csv")))
    assert rows[5]["who"] == "'=HYPERLINK(1)"
    assert rows[0]["at"] == "2026-12-01T18:00:00.123456Z"

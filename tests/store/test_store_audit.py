"""The audit log on both databases: rows can be added, but not changed or removed."""

from __future__ import annotations

import csv
import json
import threading
from datetime import UTC, datetime

import pytest
from sqlalchemy import text, update
from sqlalchemy.exc import DBAPIError

from gss.operations.accounts.audit import FIELDS, FIRST, AuditService, hash_of
from gss.operations.accounts.audit_anchor import AnchorFile
from gss.store.audit import AuditFilter, add, iterate_all, last
from gss.store.models import AuditRow


def now() -> datetime:
    return datetime(2026, 12, 1, 18, 0, 0, 123456, tzinfo=UTC)


@pytest.fixture
def anchors(tmp_path) -> AnchorFile:
    """Anchor file beside the database."""
    return AnchorFile(tmp_path / "anchors.jsonl")


@pytest.fixture
def audit(database, anchors) -> AuditService:
    """Audit log with five rows."""
    service = AuditService(database, now, anchors)
    service.begin_anchors()
    for number in range(5):
        service.record("ann", "link.open_link", f"/link/{number}", "done", role="operator", address="127.0.0.1")
    return service


@pytest.mark.parametrize(
    "statement",
    ["UPDATE audit SET who = 'eve' WHERE seq = 2", "DELETE FROM audit", "DELETE FROM audit WHERE seq = 5"],
)
def test_the_database_itself_rejects_changes_and_removal_of_rows(audit, database, statement):
    """Triggers in the database reject changes and removal of rows by any program."""
    with pytest.raises(DBAPIError, match="append-only"), database.engine.begin() as connection:
        connection.execute(text(statement))
    assert audit.verify().problem == ""
    assert audit.verify().rows == 5


def test_a_row_cannot_be_replaced_by_other_statements(audit, database):
    """SQLite's INSERT OR REPLACE and PostgreSQL's TRUNCATE would bypass the triggers on rows; both are rejected."""
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
def test_a_change_without_triggers_breaks_the_chain(audit, database, statement, problem):
    """If a row is changed or removed without triggers, the hash chain identifies it."""
    with database.engine.begin() as connection:
        if database.engine.dialect.name == "sqlite":
            connection.execute(text("DROP TRIGGER audit_no_update"))
            connection.execute(text("DROP TRIGGER audit_no_delete"))
        else:
            connection.execute(text("DROP TRIGGER audit_no_change ON audit"))
        connection.execute(text(statement))
    assert audit.verify().problem == problem


def test_rows_before_the_first_one_are_detected(audit, database):
    """A row before the first one, which no trigger rejects and no hash depends on, is detected by counting."""
    copy = "INSERT INTO audit SELECT -1, at, 'eve', role, action, target, result, detail, address, 'nothing', hash"
    with database.engine.begin() as connection:
        connection.execute(text(f"{copy} FROM audit WHERE seq = 2"))
    assert audit.verify().problem == "1 rows precede the first row"


def test_a_truncated_end_is_detected_with_an_exported_hash(audit, database, anchors):
    """If log and anchor file were both truncated, the last hash of an earlier export reveals it."""
    anchors.path.write_text("".join(anchors.path.read_text().splitlines(keepends=True)[:4]))
    exported_hash = audit.verify().last_hash
    with database.engine.begin() as connection:
        sqlite = database.engine.dialect.name == "sqlite"
        connection.execute(text("DROP TRIGGER audit_no_delete" if sqlite else "DROP TRIGGER audit_no_change ON audit"))
        connection.execute(text("DELETE FROM audit WHERE seq = 5"))
    assert "no longer rejects changes" in audit.verify().problem
    assert "was truncated" in audit.verify(exported_hash).problem


def test_a_missing_or_changed_trigger_is_detected(audit, database):
    """A trigger that was dropped, disabled or replaced by an ineffective one is reported, even if no row was changed."""
    sqlite = database.engine.dialect.name == "sqlite"
    assert audit.verify().problem == ""
    ineffective = "CREATE TRIGGER audit_no_delete BEFORE DELETE ON audit BEGIN SELECT 1; END"
    never = "CREATE TRIGGER audit_no_delete BEFORE DELETE ON audit WHEN 0 BEGIN SELECT RAISE(ABORT, 'no'); END"
    partial = (
        "CREATE TRIGGER audit_no_delete BEFORE DELETE ON audit BEGIN SELECT RAISE(ABORT, 'no') WHERE OLD.who = 'x'; END"
    )
    steps = [["DROP TRIGGER audit_no_delete"], [ineffective]]
    steps += [["DROP TRIGGER audit_no_delete", other] for other in (never, partial)]
    if not sqlite:
        steps = [["ALTER TABLE audit DISABLE TRIGGER audit_no_change"], ["DROP TRIGGER audit_no_change ON audit"]]
    for step in steps:
        with database.engine.begin() as connection:
            for statement in step:
                connection.execute(text(statement))
        name = "audit_no_delete" if sqlite else "audit_no_change"
        assert audit.verify().problem == f"the database no longer rejects changes of the audit log: {name}"


def test_the_hash_includes_the_full_time_and_older_rows_still_verify(audit, database):
    """A row of an older version, whose hash includes milliseconds, is valid. In a new row a change of one microsecond is
    detected."""
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


def remove_triggers(database) -> None:
    """Remove the triggers, as an attacker with access to the file would."""
    sqlite = database.engine.dialect.name == "sqlite"
    names = ("audit_no_update", "audit_no_delete", "audit_no_replace") if sqlite else ("audit_no_change",)
    with database.engine.begin() as connection:
        for name in names:
            connection.execute(text(f"DROP TRIGGER {name}" + ("" if sqlite else " ON audit")))


def rewrite_log(database, without: int) -> None:
    """Delete a row and rebuild numbers and hashes of all later ones, so that the chain itself is intact."""
    remove_triggers(database)
    rows = [AuditRow(**{f: getattr(row, f) for f in FIELDS}) for row in iterate_all(database, AuditFilter())]
    with database.unit_of_work() as session:
        session.execute(text("DELETE FROM audit"))
        previous = FIRST
        for number, row in enumerate((row for row in rows if row.seq != without), 1):
            row.seq, row.previous = number, previous
            row.hash = previous = hash_of(row)
            session.add(row)
            session.flush()


def test_a_truncated_end_contradicts_the_anchors(audit, database):
    """A truncated log contradicts the anchors, also after new rows have the numbers of the removed ones."""
    remove_triggers(database)
    with database.engine.begin() as connection:
        connection.execute(text("DELETE FROM audit WHERE seq >= 4"))
    assert "row 5, anchored 2026-12-01T18:00:00.123Z, is missing" in audit.compare()
    for _ in range(3):
        audit.record("eve", "x.y", "instead", "done")
    assert audit.compare() == ""
    assert audit.verify().problem.startswith("row 4 differs from its anchor")


def test_a_rewritten_log_contradicts_the_anchors(audit, database):
    """If all hashes were recomputed after a change, the anchor file reveals it."""
    rewrite_log(database, without=2)
    assert audit.verify().rows == 4
    assert audit.verify().problem.startswith("row 2 differs from its anchor")
    assert "row 5" in audit.compare()


def test_a_removed_anchor_file_is_a_problem(audit, anchors):
    """If the anchor file is missing, rows are still written, no new file is created, and the problem is reported."""
    anchors.path.unlink()
    audit.begin_anchors()
    audit.record("ann", "x.y", "z", "done")
    assert not anchors.exists()
    assert "the anchor file cannot be read" in audit.compare()
    assert "the anchor file cannot be read" in audit.verify().problem


def test_the_log_of_an_older_version_is_anchored_from_its_last_row(database, anchors):
    """A log without anchors is not reported as a problem. Anchoring starts with its last row."""
    older = AuditService(database, now, anchors)
    for number in range(3):
        older.record("ann", "x.y", str(number), "done")
    assert (older.compare(), older.verify().problem, older.verify().anchors) == ("", "", "")
    older.begin_anchors()
    older.record("ann", "x.y", "after", "done")
    assert older.verify().anchors == "anchors.jsonl confirms rows 3 to 4"


def test_a_replaced_database_is_accepted_with_a_reason(audit, database, anchors):
    """A replaced database can be accepted with a reason, which is stored in the anchor file and the log."""
    rewrite_log(database, without=5)
    assert audit.compare()
    audit.accept("shell:ann", "older copy put back")
    verdict = audit.verify()
    assert "no longer rejects changes" in verdict.problem  # the triggers, not the anchors
    assert "by shell:ann: older copy put back" in verdict.anchors
    assert audit.compare() == ""
    assert audit.page(AuditFilter(action="audit.accept"), 1)[0].detail == "older copy put back"
    assert len(anchors.path.read_text().splitlines()) == 7


def test_damaged_lines_of_the_anchor_file_are_skipped(audit, anchors):
    """Invalid lines of the anchor file, as after a power failure, are skipped."""
    with anchors.path.open("a") as file:
        file.write('{"seq": 6, "ha\n[1]\n{"seq": "x", "hash": "y", "at": ""}\n')
    audit.record("ann", "x.y", "z", "done")
    assert (audit.compare(), audit.verify().problem) == ("", "")


def test_a_row_is_stored_while_its_anchor_cannot_be_written(audit, anchors):
    """If the anchor cannot be written, the row is stored. A log with more rows than anchors is valid."""
    aside = anchors.path.rename(anchors.path.with_suffix(".aside"))
    anchors.path.symlink_to("/dev/full")
    audit.record("ann", "x.y", "z", "done")
    aside.replace(anchors.path)
    assert (audit.verify().problem, audit.verify().rows) == ("", 6)


def test_several_writers_make_one_chain(database, anchors):
    """With two services and four threads, each row is stored once and contains the hash of the previous row."""
    services = [AuditService(database, now, anchors) for _ in range(2)]
    services[0].begin_anchors()

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
    assert verdict.anchors == "anchors.jsonl confirms rows 1 to 40"
    assert {(row.who, row.target) for row in services[0].page(AuditFilter(), 100)} == {
        (f"w{w}", str(r)) for w in range(4) for r in range(10)
    }


def test_the_log_is_filtered_paged_and_exported(audit):
    """Pages list the newest row first, exports the oldest. Input text cannot add a line or a formula to an export."""
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

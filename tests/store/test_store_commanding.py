"""Command history, procedures and authority, on every supported database."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import pytest

from gss.domain.errors import NotFound
from gss.store import authority, commands, paging, procedures
from gss.store.commands import Filter
from gss.store.models import Procedure, ProcedureRun

T0 = datetime(2026, 12, 1, 18, 0, tzinfo=UTC)


@pytest.fixture
def database_with_commands(database):
    """Database with six commands, a minute apart, with alternating names."""
    with database.unit_of_work() as session:
        for k in range(6):
            name, arguments = ("RESET", {}) if k % 2 else ("SET_EXPOSURE", {"exposure_ms": 100 + k})
            arguments = {"text": "Prüfung"} if k == 1 else arguments
            row = commands.add(
                session,
                T0 + timedelta(minutes=k),
                contact_id=None,
                request_id=k + 1,
                name=name,
                arguments=arguments,
                user="ann" if k < 3 else "bob",
                source="form",
            )
            row.result, row.detail = ("completed", "") if k != 5 else ("failed", "50 % of 7_x")
    return database


@pytest.mark.parametrize(
    ("filter_used", "ids"),
    [
        (Filter(), [6, 5, 4, 3, 2, 1]),
        (Filter(start=T0 + timedelta(minutes=2), end=T0 + timedelta(minutes=4)), [4, 3]),
        (Filter(names=("RESET",), user="bob"), [6, 4]),
        (Filter(results=("failed", "unknown")), [6]),
        (Filter(text="102"), [3]),
        (Filter(text="exposure_MS"), [5, 3, 1]),
        (Filter(text="50 % of"), [6]),
        (Filter(text="7_x"), [6]),
        (Filter(text="Prüf"), [2]),
        (Filter(text="50%"), []),
        (Filter(text="1%2"), []),
        (Filter(run_id=1), []),
    ],
)
def test_a_filter_means_the_same_in_every_database(database_with_commands, filter_used, ids):
    """A filter returns the same rows in every database, newest first in pages and oldest first in full. Text is searched
    literally, ignoring case."""
    with database_with_commands.unit_of_work() as session:
        assert [row.id for row in commands.page(session, filter_used, 100)] == ids
    assert [row.id for row in commands.iterate_all(database_with_commands, filter_used)] == ids[::-1]


def test_an_export_in_batches_has_no_gaps_or_duplicates(database_with_commands, monkeypatch):
    """With any batch size, each row is returned once with its stages, and no connection is held for the reader."""
    for size in (1, 2, 3, 6, 7):
        monkeypatch.setattr(paging, "BATCH", size)
        rows = []
        for row in commands.iterate_all(database_with_commands, Filter()):
            assert database_with_commands.engine.pool.checkedout() == 0
            rows.append((row.id, [s.stage for s in row.stages]))
        assert rows == [(k, ["queued"]) for k in range(1, 7)]


def test_facets_list_the_existing_values(database_with_commands):
    """Facets list each existing value once, sorted."""
    with database_with_commands.unit_of_work() as session:
        assert commands.facets(session) == {
            "names": ["RESET", "SET_EXPOSURE"],
            "users": ["ann", "bob"],
            "results": ["completed", "failed"],
            "sources": ["form"],
        }


def test_a_deleted_procedure_keeps_its_runs(database):
    """Deleting a procedure keeps the records of its runs."""
    with database.unit_of_work() as session:
        row = Procedure(name="s", text="# s\n", author="ann", changed=T0)
        procedures.add(session, row)
        run = ProcedureRun(
            procedure_id=row.id,
            name="s",
            text=row.text,
            instrument="",
            user="ann",
            automatic=False,
            state="running",
            current="a",
            entries=[],
            started=T0,
        )
        procedures.add(session, run)
    with database.unit_of_work() as session:
        assert procedures.running(session).id == run.id
        procedures.delete(session, row.id)
    with database.unit_of_work() as session:
        assert procedures.get_run(session, run.id).procedure_id is None
        assert procedures.named(session, "s") is None
        with pytest.raises(NotFound):
            procedures.get(session, row.id)


def test_the_row_without_an_end_is_the_holder(database):
    """The row without an end is the current holder of the authority. Ended rows are the history."""
    with database.unit_of_work() as session:
        assert authority.holder(session) is None
        row = authority.take(session, "ann", T0)
        assert authority.holder(session) is row
        authority.end(session, row, T0 + timedelta(minutes=1), "bob", "pass begins")
        assert authority.holder(session) is None
        authority.take(session, "bob", T0 + timedelta(minutes=1))
        assert [r.holder for r in authority.newest(session, 5)] == ["bob", "ann"]

"""Migration of every released schema with data to the newest one, also if the process is killed during the migration."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import signal
import sqlite3
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest
import sqlalchemy as sa
from alembic import command
from alembic.autogenerate import compare_metadata
from alembic.runtime.migration import MigrationContext

from gss.operations.passes.plans import items_of
from gss.operations.procedures.run_record import entries_of, is_intact
from gss.store.engine import Database, open_engine
from gss.store.migration import known_schemas, migrate, migration_config, open_for_migration
from gss.store.models import ApiToken, Base, Command, PassPlan, Procedure, ProcedureRun

ROWS = 3
QUICK_LIST = Path(__file__).parent / "quick_list.md"
"""A stack as the migration writes it. The page tests that its editor reads and writes the same text."""
AT = datetime(2026, 1, 2, 3, 4, 5)
SCHEMAS = known_schemas()
CONVERTED = {"stacks": "procedures", "stack_runs": "procedure_runs"}
RENAMED = {("bank_history", "told"): "reported"}
RENUMBERED = ("commands", "run_id")
"""References to the runs of stacks, which have new ids as runs of procedures."""


@pytest.fixture(scope="module")
def create_schema(tmp_path_factory: pytest.TempPathFactory) -> Callable[[str, str], None]:
    """Function that creates an empty database of a schema. On SQLite, it starts with a copy of the latest older schema that it
    has created, so that each migration of empty tables runs once."""
    folder = tmp_path_factory.mktemp("schemas")

    def create(url: str, schema: str) -> None:
        older = [name for name in SCHEMAS[: SCHEMAS.index(schema) + 1] if (folder / name).exists()]
        file = Path(sa.make_url(url).database or "")
        if url.startswith("sqlite") and older:
            shutil.copyfile(folder / older[-1], file)
        command.upgrade(migration_config(url), schema)
        if url.startswith("sqlite"):
            shutil.copyfile(file, folder / schema)

    return create


@pytest.fixture
def fill_schema(create_schema: Callable[[str, str], None]) -> Callable[[str, str], dict[str, list[dict[str, Any]]]]:
    """Function that creates a database of a schema with rows in every table, generated from the columns, and returns the
    rows."""

    def fill(url: str, schema: str) -> dict[str, list[dict[str, Any]]]:
        create_schema(url, schema)
        return _fill(url)

    return fill


def _fill(url: str) -> dict[str, list[dict[str, Any]]]:
    engine = open_for_migration(url)
    metadata = sa.MetaData()
    with engine.begin() as connection:
        metadata.reflect(connection)
        tables = [t for t in metadata.sorted_tables if t.name != "alembic_version"]
        for table in tables:
            connection.execute(table.insert(), [row_of(table, k) for k in range(1, ROWS + 1)])
            if engine.dialect.name == "postgresql" and "id" in table.c:  # the given ids do not advance the sequence
                sequence = sa.func.pg_get_serial_sequence(table.name, "id")
                connection.execute(sa.select(sa.func.setval(sequence, ROWS)))
    engine.dispose()
    return read(url, [t.name for t in tables], metadata)


def row_of(table: sa.Table, k: int) -> dict[str, Any]:
    """Return values of the columns' types. References refer to rows with the same number."""
    return {column.name: value_of(table, column, k) for column in table.columns}


def value_of(table: sa.Table, column: sa.Column[Any], k: int) -> Any:
    """Return a value of the column's type."""
    kind = column.type
    if isinstance(kind, sa.Boolean):
        return k % 2 == 0
    if isinstance(kind, sa.Integer):
        return k
    if isinstance(kind, sa.Float | sa.Numeric):
        return k + 0.25
    if isinstance(kind, sa.DateTime):
        return AT + timedelta(days=k, microseconds=k)
    if isinstance(kind, sa.JSON):
        return {"name": f"{table.name} {k}", "list": [1, "é", None, 2.5]}
    if isinstance(kind, sa.LargeBinary):
        return bytes([k])
    return f"{column.name} {k} é"[: getattr(kind, "length", None) or 60]


def read(url: str, names: list[str], metadata: sa.MetaData | None = None) -> dict[str, list[dict[str, Any]]]:
    """Return the rows of these tables. ``metadata``: the tables of the database, if they are known."""
    engine = open_engine(url)
    with engine.connect() as connection:
        if metadata is None:
            metadata = sa.MetaData()
            metadata.reflect(connection, only=names)
        content = {}
        for name in names:
            table = metadata.tables[name]
            rows = connection.execute(table.select().order_by(*table.primary_key.columns)).mappings()
            content[name] = [dict(row) for row in rows]
    engine.dispose()
    return content


CHECKED: dict[tuple[str, ...], sa.MetaData] = {}
"""Reflected tables of the schemas that equal the models, by the definitions of the schema."""
DEFINITIONS = {
    "sqlite": "SELECT type || name || coalesce(sql, '') FROM sqlite_master ORDER BY 1",
    "postgresql": """
        SELECT concat_ws(' ', table_name, column_name, data_type, character_maximum_length, is_nullable, column_default)
        FROM information_schema.columns WHERE table_schema = 'public'
        UNION ALL SELECT indexdef FROM pg_indexes WHERE schemaname = 'public'
        UNION ALL SELECT concat_ws(' ', conrelid::regclass, conname, pg_get_constraintdef(oid))
        FROM pg_constraint WHERE connamespace = 'public'::regnamespace ORDER BY 1""",
}
"""Statement that reads the definitions of all tables, columns, indexes and constraints."""


def definitions(url: str) -> tuple[str, ...]:
    """Return the definitions of the schema of a database."""
    engine = open_engine(url)
    with engine.connect() as connection:
        statements = tuple(connection.exec_driver_sql(DEFINITIONS[engine.dialect.name]).scalars())
    engine.dispose()
    return statements


def reflected(url: str) -> sa.MetaData:
    """Return the tables of the database."""
    engine, metadata = open_engine(url), sa.MetaData()
    with engine.connect() as connection:
        metadata.reflect(connection)
    engine.dispose()
    return metadata


def check(url: str, before: dict[str, list[dict[str, Any]]]) -> None:
    """Check that the newest schema contains all previous rows and is readable by the models. Stacks and their runs are
    additional procedures and their runs. A schema with the same definitions as a checked one is not reflected again."""
    kept = [name for name in before if name not in CONVERTED]
    defined = definitions(url)
    metadata = CHECKED.get(defined) or reflected(url)
    after = read(url, kept, metadata)
    added = {CONVERTED[name]: ROWS for name in before if name in CONVERTED}
    for name in kept:
        rows = [{RENAMED.get((name, key), key): value for key, value in row.items()} for row in before[name]]
        stored = [{k: row[k] for k in rows[0] if k in row and (name, k) != RENUMBERED} for row in after[name][:ROWS]]
        assert stored == [{k: v for k, v in row.items() if k in stored[0]} for row in rows], name
    engine = open_engine(url)
    with engine.connect() as connection:
        if defined not in CHECKED:
            assert compare_metadata(MigrationContext.configure(connection), Base.metadata) == []
        if url.startswith("sqlite"):
            assert connection.exec_driver_sql("PRAGMA foreign_key_check").all() == []
            assert connection.exec_driver_sql("PRAGMA integrity_check").scalar() == "ok"
    CHECKED[defined] = metadata
    database = Database(engine)
    with database.unit_of_work() as session:
        for mapper in Base.registry.mappers:
            name = mapper.local_table.name
            if name in before:
                assert len(session.scalars(sa.select(mapper.class_)).unique().all()) == ROWS + added.get(name, 0)
    database.close()


@pytest.mark.parametrize(
    ("database_url", "schema"),
    [
        *(("sqlite", schema) for schema in SCHEMAS[:-1]),
        *(pytest.param("postgres", schema, marks=pytest.mark.postgres) for schema in SCHEMAS[:-1:3]),
    ],
    indirect=["database_url"],
)
def test_data_of_every_released_schema_are_migrated(database_url, schema, fill_schema):
    """All values of three rows in every table of each older schema are in the migrated one, and the models read them.

    On PostgreSQL only every third schema is migrated, which still runs each step with data in the tables that it
    changes."""
    before = fill_schema(database_url, schema)
    migrate(database_url)
    check(database_url, before)


CAMERA, FULL_DETAIL = {"columns": 8}, {"stars": [], "grid": []}
SHORT_DETAIL: dict[str, Any] = {"stars": []}
OLD_SOLUTIONS = [
    # frame, chain, origin, replay, camera, detail, outcome; True if the migration makes the result operational
    (1, "reference", "ground", None, CAMERA, FULL_DETAIL, "none", True),
    (1, "cubestar", "ground", "equal", CAMERA, FULL_DETAIL, "solved", False),
    (1, "reference", "ground", None, CAMERA, FULL_DETAIL, "solved", False),
    (1, "oersted", "ground", None, CAMERA, SHORT_DETAIL, "solved", False),
    (2, "cubestar", "ground", None, CAMERA, FULL_DETAIL, "solved", False),
    (2, "cubestar", "ground", None, CAMERA, FULL_DETAIL, "solved", True),
    (2, "reference", "ground", None, CAMERA, SHORT_DETAIL, "solved", False),
    (3, "oersted", "ground", None, CAMERA, SHORT_DETAIL, "solved", False),
    (3, "reference", "ground", None, {}, {}, "none", False),
    (3, "reference", "ground", None, CAMERA, SHORT_DETAIL, "solved", True),
    (3, "reference", "on board", None, CAMERA, FULL_DETAIL, "solved", False),
]


def test_stored_results_get_an_operational_one_per_frame(database_url, fill_schema):
    """For each frame the migration selects the result of the configured chain at reception as operational, else another
    result outside campaigns, else the campaign's result with that chain."""
    fill_schema(database_url, "0006")
    engine = open_engine(database_url)
    metadata = sa.MetaData()
    with engine.begin() as connection:
        metadata.reflect(connection, only=["solutions"])
        table = metadata.tables["solutions"]
        connection.execute(table.delete())
        for k, (frame, chain, origin, replay, camera, detail, outcome, _) in enumerate(OLD_SOLUTIONS, 1):
            values = {"frame_id": frame, "chain": chain, "origin": origin, "replay": replay, "outcome": outcome}
            connection.execute(table.insert(), row_of(table, k) | values | {"camera": camera, "detail": detail})
    engine.dispose()
    migrate(database_url)
    rows = read(database_url, ["solutions"])["solutions"]
    assert [bool(row["operational"]) for row in rows] == [operational for *_, operational in OLD_SOLUTIONS]
    assert {row["camera_name"] for row in rows} == {""}


def test_earlier_rows_have_an_unknown_instrument_version(database_url, fill_schema):
    """The instrument version of earlier rows is null after migration, and the rows are otherwise unchanged."""
    before = fill_schema(database_url, "0008")
    migrate(database_url)
    tables = ["frames", "contacts", "catalogues"]
    for table, rows in read(database_url, tables).items():
        assert [row["instrument_version"] for row in rows] == [None] * len(before[table])
    check(database_url, before)


def test_earlier_imports_at_the_time_of_their_import_have_an_unknown_time(database_url, fill_schema):
    """Only an imported frame that was taken within five seconds of its import gets an unknown time."""
    fill_schema(database_url, "0023")
    engine = open_engine(database_url)
    metadata = sa.MetaData()
    rows = [("import", 1.0), ("import", 90.0), ("device", 1.0)]
    with engine.begin() as connection:
        metadata.reflect(connection, only=["frames"])
        table = metadata.tables["frames"]
        ids = connection.scalars(sa.select(table.c.id).order_by(table.c.id)).all()
        for frame_id, (source, delay_s) in zip(ids, rows, strict=False):
            values = {"source": source, "taken": AT, "received": AT + timedelta(seconds=delay_s)}
            connection.execute(table.update().where(table.c.id == frame_id).values(**values))
    engine.dispose()
    migrate(database_url)
    stored = read(database_url, ["frames"])["frames"]
    assert [bool(row["time_known"]) for row in stored[: len(rows)]] == [False, True, True]


STEPS = [
    {"command": "GET_STATUS", "arguments": {}, "delay_s": 0.0, "condition": None, "note": "first\n# light"},
    {
        "command": "SET_EXPOSURE",
        "arguments": {"exposure_ms": 120},
        "delay_s": 1.5,
        "condition": {"packet": "housekeeping", "field": "mode", "op": "ne", "value": "tracking", "wait_s": 20.0},
        "note": "",
    },
]
STACK = {"id": 5, "name": "procedure 1", "note": "before\nthe pass", "steps": STEPS, "author": "ann", "changed": AT}
RUN = {"id": 7, "stack_id": 5, "name": "evening", "state": "failed", "step": 1, "reason": "step 2", "user": "bob"}
PROGRESS = [
    {"state": "completed", "command_id": 2, "detail": ""},
    {"state": "failed", "command_id": None, "detail": "x"},
]


def test_ids_of_removed_packets_and_procedures_are_not_used_again(database_url, fill_schema):
    """After the migration, the id of the newest packet or procedure is not used again if the row is removed."""
    fill_schema(database_url, "0028")
    migrate(database_url)
    tables, engine = reflected(database_url).tables, open_engine(database_url)
    with engine.begin() as connection:
        connection.execute(tables["procedure_runs"].update().values(procedure_id=None))
        for table in (tables["telemetry_packets"], tables["procedures"]):
            connection.execute(table.delete())
            connection.execute(table.insert(), {k: v for k, v in row_of(table, 1).items() if k != "id"})
            assert connection.scalars(sa.select(table.c.id)).all() == [ROWS + 1]
    engine.dispose()


def test_a_stack_its_run_plan_and_token_refer_to_a_procedure(database_url, fill_schema):
    """A stack becomes a procedure with the same name, author, time, steps and waits, with a number if the name is used. Its
    run becomes a record with a valid hash. The reviewed item of a plan and the scope of a token refer to procedures."""
    fill_schema(database_url, "0020")
    engine = open_engine(database_url)
    metadata = sa.MetaData()
    reviewed = hashlib.sha256(json.dumps(STEPS, sort_keys=True).encode()).hexdigest()
    item = {"kind": "stack", "title": "Stack procedure 1", "estimated_s": 9.0, "procedure_id": None, "stack_id": 5}
    items = [item | {"started_id": 7, "reviewed_sha256": reviewed}, item | {"stack_id": 77, "started_id": None}]
    run_steps = [step | progress for step, progress in zip(STEPS, PROGRESS, strict=True)]
    with engine.begin() as connection:
        metadata.reflect(connection)
        tables = metadata.tables
        connection.execute(
            tables["procedures"].update().where(tables["procedures"].c.id == 1).values(name="procedure 1")
        )
        connection.execute(tables["stacks"].insert(), STACK)
        connection.execute(tables["stack_runs"].insert(), RUN | {"steps": run_steps, "started": AT, "finished": AT})
        connection.execute(tables["commands"].update().where(tables["commands"].c.id == 2).values(run_id=7))
        connection.execute(tables["pass_plans"].update().where(tables["pass_plans"].c.id == 1).values(items=items))
        connection.execute(tables["api_tokens"].update().values(scopes=["view", "stacks"]))
    engine.dispose()
    migrate(database_url)
    database = Database(open_engine(database_url))
    with database.unit_of_work() as session:
        row = session.scalars(sa.select(Procedure).where(Procedure.name == "procedure 1 (2)")).one()
        assert (row.author, row.changed) == ("ann", AT.replace(tzinfo=UTC))
        assert row.text == QUICK_LIST.read_text()
        run = session.scalars(sa.select(ProcedureRun).where(ProcedureRun.name == "evening")).one()
        assert (run.state, run.procedure_id, run.user, is_intact(run)) == ("stopped", row.id, "bob", True)
        assert [(e.step, e.state, e.command_id) for e in entries_of(run)] == [
            ("send-1", "done", 2),
            ("send-2", "failed", None),
        ]
        assert session.get_one(Command, 2).run_id == run.id
        first, second = items_of(session.get_one(PassPlan, 1))
        assert (first.kind, first.title, first.started_id) == ("procedure", "Procedure procedure 1 (2)", run.id)
        assert first.reviewed_sha256 == hashlib.sha256(row.text.encode()).hexdigest()
        assert (first.procedure_id, second.procedure_id) == (row.id, 0)
        assert {tuple(token.scopes) for token in session.scalars(sa.select(ApiToken))} == {("view", "procedures")}
    database.close()


def migrate_and_die(url: str, statement: int) -> bool:
    """Migrate in a process that is killed when it sends this statement. Return False if it completed before."""
    child = os.fork()
    if child == 0:
        count_sent = 0

        def count(*_: object) -> None:
            nonlocal count_sent
            count_sent += 1
            if count_sent == statement:
                os.kill(os.getpid(), signal.SIGKILL)

        sa.event.listen(sa.Engine, "before_cursor_execute", count)
        try:
            migrate(url)
        finally:
            os._exit(0)
    _, status = os.waitpid(child, 0)
    return os.WIFSIGNALED(status)


def test_a_migration_killed_at_any_statement_leaves_the_old_schema_intact(tmp_path: Path, fill_schema):
    """If the migration is killed at a statement, the old schema and its data are intact, and the next start completes the
    migration."""
    url = f"sqlite:///{tmp_path / 'full.db'}"
    before = fill_schema(url, SCHEMAS[0])
    defined, metadata = definitions(url), reflected(url)
    killed, statement = 0, 1
    while True:
        for file in tmp_path.glob("trial.db*"):
            file.unlink()
        shutil.copy(tmp_path / "full.db", tmp_path / "trial.db")
        trial = f"sqlite:///{tmp_path / 'trial.db'}"
        if not migrate_and_die(trial, statement):
            break
        killed += 1
        with sqlite3.connect(tmp_path / "trial.db") as connection:
            assert connection.execute("SELECT version_num FROM alembic_version").fetchone() == (SCHEMAS[0],)
            assert connection.execute("PRAGMA integrity_check").fetchone() == ("ok",)
        connection.close()
        assert definitions(trial) == defined
        assert read(trial, list(before), metadata) == before
        statement += max(1, statement // 3)  # each of the first statements, then with increasing steps
    migrate(trial)
    check(trial, before)
    assert killed > 8


@pytest.mark.postgres
def test_a_migration_killed_on_postgresql_leaves_the_old_schema_intact(request, tmp_path, fill_schema):
    """A migration on PostgreSQL that is killed leaves the old schema and its data intact, because its transactions
    include schema changes."""
    url = request.getfixturevalue("postgres_url")
    for statement in (12, 40):
        engine = open_engine(url)
        with engine.begin() as connection:
            connection.execute(sa.text("DROP SCHEMA public CASCADE"))
            connection.execute(sa.text("CREATE SCHEMA public"))
        engine.dispose()
        before = fill_schema(url, SCHEMAS[0])
        assert migrate_and_die(url, statement)
        assert read(url, list(before)) == before
        migrate(url)
        check(url, before)

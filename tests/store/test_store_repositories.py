"""Repositories, on every supported database."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import pytest
from alembic import command
from alembic.autogenerate import compare_metadata
from alembic.migration import MigrationContext
from sqlalchemy import inspect, text

from gss.domain.errors import CorruptData, NotFound
from gss.store import catalogues, commands, devices, events, frames, jobs, telemetry, transfers
from gss.store.blobs import BlobStore
from gss.store.engine import open_engine
from gss.store.migration import migrate, migration_config, open_for_migration
from gss.store.models import Base, Catalogue, Frame, Job, Solution, TelemetryPacket, Transfer

T0 = datetime(2026, 12, 1, 18, 0, tzinfo=UTC)


def frame_row(**values) -> Frame:
    """Return a frame's row with the required columns only."""
    row = {
        "source": "device",
        "name": "f",
        "taken": T0,
        "received": T0,
        "columns": 4,
        "rows": 2,
        "bits": 8,
        "dtype": "|u1",
        "sha256": "0" * 64,
        "complete": True,
        "rows_held": [[0, 1]],
        "parameters": {},
    }
    return Frame(**(row | values))


def solution_row(frame_id: int, origin: str, outcome: str) -> Solution:
    """Return a solution's row with the required columns only."""
    return Solution(frame_id=frame_id, origin=origin, chain="c", version="1", created=T0, outcome=outcome, detail={})


def schema_of(url):
    """Return all tables with columns, keys and indexes, and all triggers, in a form that can be compared."""
    engine = open_engine(url)
    with engine.connect() as connection:
        inspector = inspect(connection)
        tables = {
            name: {
                "columns": {c["name"]: (str(c["type"]), c["nullable"]) for c in inspector.get_columns(name)},
                "key": inspector.get_pk_constraint(name),
                "references": by_name(inspector.get_foreign_keys(name)),
                "unique": by_name(inspector.get_unique_constraints(name)),
                "indexes": by_name(inspector.get_indexes(name)),
                "checks": by_name(inspector.get_check_constraints(name)),
            }
            for name in inspector.get_table_names()
        }
        source = (
            "SELECT name, sql FROM sqlite_master WHERE type = 'trigger' ORDER BY name"
            if url.startswith("sqlite")
            else "SELECT tgname, pg_get_triggerdef(oid) FROM pg_trigger WHERE NOT tgisinternal ORDER BY tgname"
        )
        triggers = connection.execute(text(source)).all()
        revision = connection.execute(text("SELECT version_num FROM alembic_version")).all()
    engine.dispose()
    return tables, triggers, revision


def by_name(parts):
    """Sort the parts that an inspector returned. The filter of a partial index is converted to text."""
    return sorted(
        (
            {k: str(v) for k, v in {**p, **p.get("dialect_options", {})}.items() if k != "dialect_options"}
            for p in parts
        ),
        key=str,
    )


def test_an_empty_database_gets_the_schema_of_the_migrations(database_url):
    """The schema created in one step equals that of all migrations: columns, keys, indexes and triggers."""
    migrate(database_url)
    created = schema_of(database_url)
    engine = open_for_migration(database_url)
    with engine.begin() as connection:
        Base.metadata.drop_all(connection)
        connection.execute(text("DROP TABLE alembic_version"))
        if not database_url.startswith("sqlite"):
            connection.execute(text("DROP FUNCTION audit_only_grows()"))
    engine.dispose()
    command.upgrade(migration_config(database_url), "head")
    assert schema_of(database_url) == created


def test_migrations_create_exactly_the_schema_of_the_models(database_url):
    """After all migrations, autogenerate finds no difference from the models."""
    command.upgrade(migration_config(database_url), "head")
    engine = open_engine(database_url)
    with engine.connect() as connection:
        assert compare_metadata(MigrationContext.configure(connection), Base.metadata) == []
    engine.dispose()


def test_migrating_twice_changes_nothing(database, database_url):
    """A second migration, as at every server start, changes nothing and keeps the data."""
    with database.unit_of_work() as session:
        frames.add(session, frame_row(name="kept"))
    migrate(database_url)
    with database.unit_of_work() as session:
        assert frames.latest(session).name == "kept"


def test_times_are_returned_in_utc_and_local_times_are_rejected(database):
    """A stored time is returned in UTC. A time without a zone is rejected."""
    with database.unit_of_work() as session:
        frames.add(session, frame_row(taken=T0.astimezone()))
    with database.unit_of_work() as session:
        assert frames.latest(session).taken == T0
        assert frames.latest(session).taken.tzinfo is UTC
    with pytest.raises(Exception, match="no time zone"), database.unit_of_work() as session:
        frames.add(session, frame_row(taken=datetime(2026, 1, 1)))


def test_a_failed_unit_of_work_stores_nothing(database):
    """A unit of work that raises an exception stores nothing."""

    def half_done() -> None:
        with database.unit_of_work() as session:
            frames.add(session, frame_row())
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        half_done()
    with database.unit_of_work() as session:
        assert frames.latest(session) is None


def test_frames_are_paged_newest_first_and_filtered_by_operational_outcome(database):
    """Frames are listed newest first. The filter uses the outcome of the operational ground solution, also combined with
    other filters."""
    with database.unit_of_work() as session:
        frame_1, frame_2, frame_3 = (
            frames.add(session, frame_row(number=n, source=s)) for n, s in ((1, "device"), (2, "import"), (3, "device"))
        )
        for frame, outcomes in ((frame_1, ("solved", "none")), (frame_2, ("solved",)), (frame_3, ("none", "solved"))):
            first, *_ = [frames.add_solution(session, solution_row(frame.id, "ground", o)).id for o in outcomes]
            frames.pin(session, frame.id, first)
        frames.add_solution(session, solution_row(frame_3.id, "on board", "solved"))
    with database.unit_of_work() as session:
        assert [f.number for f in frames.page(session, 10, 0)[1]] == [3, 2, 1]
        assert [f.number for f in frames.page(session, 1, 1)[1]] == [2]
        total, solved = frames.page(session, 10, 0, outcome="solved")
        assert (total, [f.number for f in solved]) == (2, [2, 1])
        assert [f.number for f in frames.page(session, 10, 0, outcome="solved", source="device")[1]] == [1]
        assert frames.newest_solution(session, frame_3.id, "on board").outcome == "solved"
        operational = frames.operational_solutions(session, [frame_1.id, frame_3.id])
        assert {k: s.outcome for k, s in operational.items()} == {frame_1.id: "solved", frame_3.id: "none"}
        assert all("detail" in inspect(row).unloaded for row in operational.values())  # a list needs no stars
        with pytest.raises(NotFound):
            frames.get(session, 999)


def test_commands_keep_their_stages_and_those_in_flight_are_found(database):
    """Commands are stored with their stages. The largest request id and the commands in progress are found after a
    restart."""
    with database.unit_of_work() as session:
        contact = devices.open_contact(session, "socket://x", T0, "c")
        for request_id, result in ((7, "completed"), (4_294_967_290, "sent")):
            row = commands.add(
                session,
                T0,
                contact_id=contact.id,
                request_id=request_id,
                name="X",
                arguments={"a": 1},
                user="u",
                source="form",
            )
            row.result = result
    with database.unit_of_work() as session:
        assert commands.last_request_id(session) == 4_294_967_290
        assert [c.request_id for c in commands.left_in_flight(session)] == [4_294_967_290]
        assert [s.stage for s in commands.by_request(session, 7).stages] == ["queued"]
        assert [c.request_id for c in commands.page(session, commands.Filter(contact_id=contact.id), 1)] == [
            4_294_967_290
        ]


def test_telemetry_spans_read_values_of_packets(database):
    """A span returns the values of fields in time order, including both ends, and None if a packet lacks a field."""
    with database.unit_of_work() as session:
        rows = [
            TelemetryPacket(
                packet="hk",
                received=T0 + timedelta(seconds=k),
                device_time_s=k,
                request_id=0,
                values={"a": k / 2, "mode": "tracking", "on": True, "items": [{"x": k}]} if k != 2 else {},
            )
            for k in range(5)
        ]
        telemetry.add_batch(session, rows)
    names, first, last = ["a", "mode", "on", "items"], T0 + timedelta(seconds=1), T0 + timedelta(seconds=3)
    for block in (1, 2, 100):
        span_rows = list(telemetry.rows(database, "hk", names, first, last, block=block))
        assert [(r.received, r.values) for r in span_rows] == [
            (T0 + timedelta(seconds=1), (0.5, "tracking", True, [{"x": 1}])),
            (T0 + timedelta(seconds=2), (None, None, None, None)),
            (T0 + timedelta(seconds=3), (1.5, "tracking", True, [{"x": 3}])),
        ]
    assert list(telemetry.rows(database, "hk", names, first, last, contact_id=1)) == []
    assert len(list(telemetry.rows(database, "hk", names, first, last, unsolicited=True))) == 3
    with database.unit_of_work() as session:
        assert [p.device_time_s for p in telemetry.newest(session, "hk", 2)] == [4, 3]


def test_contacts_count_their_frames_and_commands(database):
    """The list of contacts has device, frames and commands. A contact left open by a crash ends at its last packet."""
    with database.unit_of_work() as session:
        device = devices.remember(session, T0, name="d", profile="p", firmware="1", simulated=True, dictionary_hash="h")
        contact = devices.open_contact(session, "u", T0, "c")
        devices.update_contact(session, contact.id, device_id=device.id, rx_bytes=10)
        frames.add(session, frame_row(contact_id=contact.id))
        last = TelemetryPacket(
            contact_id=contact.id,
            packet="hk",
            received=T0 + timedelta(seconds=4),
            device_time_s=0,
            request_id=0,
            values={},
        )
        telemetry.add_batch(session, [last])
        devices.close_left_open(session, T0 + timedelta(seconds=9))
    with database.unit_of_work() as session:
        ((row, device_row, n_frames, n_commands),) = devices.list_contacts(session, 5)
        assert (device_row.name, n_frames, n_commands, row.rx_bytes) == ("d", 1, 0, 10)
        assert row.ended == T0 + timedelta(seconds=4)


def test_a_contact_left_open_does_not_end_before_its_start(database):
    """If the clock was set back before the restart, a contact left open ends at its start."""
    with database.unit_of_work() as session:
        devices.open_contact(session, "u", T0, "c")
        devices.close_left_open(session, T0 - timedelta(hours=3))
    with database.unit_of_work() as session:
        ((row, *_),) = devices.list_contacts(session, 5)
        assert (row.started, row.ended) == (T0, T0)


def test_the_cause_of_a_closed_line_is_found_in_new_and_old_events(database):
    """The cause of a closed line is found in events of all versions; up to 0.4 their text began in lower case."""
    with database.unit_of_work() as session:
        for contact_id, text in ((1, "line closed: the cable was cut"), (2, "Line closed: closed by the operator")):
            events.add(session, T0, "link", "watch", text, {"contact_id": contact_id})
        events.add(session, T0, "link", "ok", "Line open on x", {"contact_id": 3})
    with database.unit_of_work() as session:
        causes = [[cause for _, cause in devices.closings(session, contact_id)] for contact_id in (1, 2, 3)]
    assert causes == [["the cable was cut"], ["closed by the operator"], []]


def test_catalogues_are_found_by_hash_and_unfinished_work_by_state(database):
    """Catalogues are found by hash, and unfinished transfers and jobs by state. Events are read after a sequence number."""
    with database.unit_of_work() as session:
        catalogues.add(
            session,
            Catalogue(
                name="c",
                profile="p",
                format="f",
                created=T0,
                author="a",
                stars=1,
                pairs=1,
                size=1,
                sha256="ab" * 32,
                request={},
                manifest={},
                report={},
            ),
        )
        for state in ("transferring", "committed"):
            transfers.add(
                session,
                Transfer(direction="up", kind="k", target="A", subject="s", state=state, created=T0, stored=[], log=[]),
            )
            jobs.add(session, Job(kind="k", title="t", state={"committed": "done"}.get(state, "running"), created=T0))
        for text in ("one", "two", "three"):
            events.add(session, T0, "k", "ok", text, {})
    with database.unit_of_work() as session:
        assert catalogues.by_sha256(session, "ab" * 32).name == "c"
        assert [t.state for t in transfers.unfinished(session)] == ["transferring"]
        assert [j.state for j in jobs.in_states(session, ("queued", "running"))] == ["running"]
        first = events.after(session, 0, 1)[0]
        assert [e.text for e in events.after(session, first.seq, 10)] == ["two", "three"]
        assert events.last_seq(session) == first.seq + 2


def test_blobs_are_stored_once_under_their_hash_and_damage_is_reported(tmp_path):
    """Equal bytes have the same key. A missing or damaged file raises an error."""
    store = BlobStore(str(tmp_path / "blobs"))
    key = store.put(b"pixels")
    assert store.put(b"pixels") == key
    assert store.get(key) == b"pixels"
    (path,) = [p for p in (tmp_path / "blobs").rglob("*") if p.is_file()]
    path.write_bytes(b"pixelz")
    with pytest.raises(CorruptData, match="damaged"):
        store.get(key)
    with pytest.raises(NotFound, match="missing"):
        store.get("0" * 64)

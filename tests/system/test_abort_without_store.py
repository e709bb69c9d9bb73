"""ABORT and the line while the store is locked: the line does not wait for the store, and nothing is lost."""

from __future__ import annotations

import json
import os
import signal
import socket
import sqlite3
import time
from collections.abc import Iterator
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path
from urllib.parse import urlsplit

import pytest
from sqlalchemy import Connection, create_engine, text
from sqlalchemy.exc import OperationalError

LOCK_WAIT_S = 5.0
"""Time that SQLite waits for a lock. An action that waits for the store takes longer."""


@contextmanager
def locked(database: Path) -> Iterator[None]:
    """Hold the write lock of the database from another connection."""
    connection = sqlite3.connect(database, isolation_level=None, timeout=30)
    connection.execute("BEGIN IMMEDIATE")
    try:
        yield
    finally:
        connection.execute("ROLLBACK")
        connection.close()


def test_abort_leaves_while_the_database_is_locked(serve, sensor):
    """ABORT stops the cycle while the lock is held. Its record is stored after the lock was released."""
    server = serve("--device", sensor.url)
    console = server.console
    console.wait("the sensor", lambda: console.get("/link")["dictionary_match"])
    console.command("SET_MODE", mode="lost_in_space")
    console.command("START_CYCLE")
    console.wait("the cycle", lambda: console.get("/link")["cycle_running"])
    with locked(server.folder / "gss.db"):
        time.sleep(1.0)  # the dispatcher meets the lock
        start_s = time.monotonic()
        receipt = console.post("/commands/abort")
        assert receipt["command"] is None
        console.wait("the cycle to stop", lambda: not console.get("/link")["cycle_running"], LOCK_WAIT_S - 1.0)
        assert time.monotonic() - start_s < LOCK_WAIT_S - 1.0

    def recorded():
        rows = console.get("/commands", name="ABORT")
        return next((row for row in rows if row["result"] == "completed"), None)

    row = console.wait("the record", recorded)
    assert row["request_id"] == receipt["request_id"]
    assert [stage["name"] for stage in row["stages"] if stage["state"] == "passed"][-1] == "completed"


@pytest.mark.parametrize("end", [signal.SIGTERM, signal.SIGKILL], ids=["SIGTERM", "SIGKILL"])
def test_abort_is_on_record_after_a_server_that_ended_while_the_database_was_locked(serve, sensor, end):
    """The next server has ABORT as a command with an unknown result and does not use its request id again."""
    server = serve("--device", sensor.url)
    console = server.console
    console.wait("the sensor", lambda: console.get("/link")["dictionary_match"])
    with locked(server.folder / "gss.db"):
        receipt = console.post("/commands/abort")
        assert receipt["command"] is None
        server.stop(end)
    console = serve("--device", sensor.url).console
    (row,) = console.get("/commands", name="ABORT")
    assert (row["request_id"], row["result"]) == (receipt["request_id"], "unknown")
    console.wait("the sensor", lambda: console.get("/link")["dictionary_match"])
    console.command("GET_STATUS")
    ids = [command["request_id"] for command in console.get("/commands")]
    assert len(ids) == len(set(ids))


def test_an_abort_whose_sender_gave_up_is_not_sent(serve, sensor):
    """A server that is stopped for a while reads a request after its sender has closed the connection, and does not send
    ABORT. A request for the server before a restart is rejected too, with the start of the present server.
    """
    server = serve("--device", sensor.url)
    console = server.console
    console.wait("the sensor", lambda: console.get("/link")["dictionary_match"])
    address = urlsplit(console.address)
    headers = "".join(f"{name}: {value}\r\n" for name, value in console.headers.items())
    request = f"POST /api/commands/abort HTTP/1.1\r\nHost: {address.netloc}\r\n{headers}Content-Length: 0\r\n\r\n"
    server.process.send_signal(signal.SIGSTOP)
    with socket.create_connection((address.hostname, address.port)) as connection:
        connection.sendall(request.encode())
    server.process.send_signal(signal.SIGCONT)
    console.command("GET_STATUS")
    started = console.get("/link")["server_started"]
    outdated = console.http.post("/commands/abort", headers={"server-started": "2026-01-01T00:00:00.000Z"})
    assert (outdated.status_code, outdated.json()["got"]) == (412, started)
    assert console.get("/commands", name="ABORT") == []
    assert console.http.post("/commands/abort", headers={"server-started": started}).status_code == 201


def test_a_stored_abort_that_is_still_in_the_journal_is_stored_once(serve, sensor):
    """A server that ended after it stored ABORT and before it removed ABORT from its journal adds no second row."""
    server = serve("--device", sensor.url)
    console = server.console
    console.wait("the sensor", lambda: console.get("/link")["dictionary_match"])
    receipt = console.post("/commands/abort")
    (record,) = console.wait("the record", lambda: console.get("/commands", name="ABORT"))
    server.kill()
    entry = {"request_id": receipt["request_id"], "user": record["user"], "source": "abort"}
    with sqlite3.connect(server.folder / "gss.db") as database:
        (created,) = database.execute("SELECT created FROM commands WHERE name = 'ABORT'").fetchone()
    entry["at"] = datetime.fromisoformat(created).replace(tzinfo=UTC).isoformat()
    (server.folder / "aborts.jsonl").write_text(json.dumps(entry) + "\n")
    console = serve("--device", sensor.url).console
    assert [row["request_id"] for row in console.get("/commands", name="ABORT")] == [receipt["request_id"]]


def test_a_line_that_opens_while_the_database_is_locked_gets_its_contact_later(serve, sensor):
    """Data and ABORT are transferred without a stored contact. Contact and capture are stored after the lock was
    released.
    """
    server = serve()
    console = server.console
    with locked(server.folder / "gss.db"):
        server.console.http.post("/link/open", json={"url": sensor.url}, timeout=90)
        console.wait("the sensor", lambda: console.get("/link")["dictionary_match"], 30)
        assert console.post("/commands/abort")["command"] is None
    contact = console.wait("the contact", lambda: next(iter(console.get("/contacts")), None))
    detail = console.wait(
        "its device", lambda: found if (found := console.get(f"/contacts/{contact['id']}"))["device"] else None
    )
    assert detail["captures"]
    console.wait("ABORT's record", lambda: console.get("/commands", name="ABORT"))


OTHERS = "FROM pg_stat_activity WHERE datname = current_database() AND pid <> pg_backend_pid()"


@contextmanager
def locked_tables(connection: Connection) -> Iterator[None]:
    """Hold the lock of a VACUUM FULL on every table: other transactions can neither read nor write. A transaction that locks
    its tables in another order causes a deadlock, and PostgreSQL then ends one of both; the locks are tried again."""
    while True:
        with connection.begin() as transaction:
            names = connection.scalars(text("SELECT tablename FROM pg_tables WHERE schemaname = 'public'")).all()
            try:
                connection.execute(text(f"LOCK TABLE {', '.join(names)} IN ACCESS EXCLUSIVE MODE"))
            except OperationalError:
                transaction.rollback()
                continue
            yield
            return


@contextmanager
def paused_server(connection: Connection) -> Iterator[None]:
    """Stop the processes of PostgreSQL that serve the server, without closing their connections."""
    processes = [int(pid) for pid in connection.scalars(text(f"SELECT pid {OTHERS}"))]
    for pid in processes:
        os.kill(pid, signal.SIGSTOP)
    try:
        yield
    finally:
        for pid in processes:
            os.kill(pid, signal.SIGCONT)


@contextmanager
def ended_server(connection: Connection) -> Iterator[None]:
    """End every connection of the server to the database, again and again."""
    connection.execute(text(f"SELECT pg_terminate_backend(pid) {OTHERS}"))
    yield
    connection.execute(text(f"SELECT pg_terminate_backend(pid) {OTHERS}"))


@pytest.fixture
def postgres(postgres_url: str) -> Iterator[Connection]:
    """Connection to an empty PostgreSQL database, separate from the connections of the server."""
    engine = create_engine(postgres_url)
    with engine.connect() as connection:
        connection.execute(text("DROP SCHEMA public CASCADE"))
        connection.execute(text("CREATE SCHEMA public"))
        connection.commit()
        yield connection
    engine.dispose()


@pytest.mark.postgres
@pytest.mark.parametrize("blocked", [locked_tables, paused_server, ended_server])
def test_abort_leaves_while_postgresql_does_not_respond(serve, sensor, postgres_url, postgres, blocked):
    """The sensor completes ABORT while all tables are locked, while PostgreSQL is stopped, and after it closed all connections.
    The record follows.
    """
    console = serve("--device", sensor.url, GSS_DATABASE=postgres_url).console
    console.wait("the sensor", lambda: console.get("/link")["dictionary_match"])
    console.command("SET_MODE", mode="lost_in_space")
    console.command("START_CYCLE")
    console.wait("the cycle", lambda: console.get("/link")["cycle_running"])
    with blocked(postgres):
        time.sleep(1.5)  # the dispatcher meets the lock, and the identity of the caller must be read again
        receipt = console.post("/commands/abort")
        time.sleep(2.0)
        released = datetime.now(UTC)

    def recorded():
        rows = console.get("/commands", name="ABORT")
        return next((row for row in rows if row["result"] == "completed"), None)

    row = console.wait("the record", recorded, 60.0)
    assert row["request_id"] == receipt["request_id"]
    completed = next(stage for stage in row["stages"] if stage["name"] == "completed")
    assert datetime.fromisoformat(completed["at"]) < released
    console.wait("the cycle to stop", lambda: not console.get("/link")["cycle_running"])

"""ABORT and the line while the store is locked: the line does not wait for the store, and nothing is lost."""

from __future__ import annotations

import signal
import sqlite3
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

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

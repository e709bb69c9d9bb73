"""The audit log is verified at start and while the server runs."""

from __future__ import annotations

import pytest
from sqlalchemy import text

from gss.instruments.roles import default_roles
from gss.operations.accounts.audit import AuditService
from gss.operations.accounts.audit_anchor import ANCHORS, AnchorFile
from gss.operations.telemetry.alarms import AlarmService
from gss.operations.telemetry.telemetry import TelemetryService
from gss.operations.upkeep.audit_watch import AuditWatch


@pytest.fixture
def audit(store) -> AuditService:
    """Audit log with three rows."""
    service = AuditService(store.database, store.clock, AnchorFile(store.folder / ANCHORS))
    service.begin_anchors()
    for number in range(3):
        service.record("ann", "x.y", str(number), "done")
    return service


@pytest.fixture
def alarms(store, bus) -> AlarmService:
    """Alarm service of a server with this store."""
    dictionary = store.link.dictionary
    telemetry = TelemetryService(
        dictionary,
        store.database,
        bus,
        store.clock,
        lambda: None,
        lambda: True,
        default_roles(dictionary).quantities.status,
    )
    return AlarmService(dictionary, telemetry, store.link, store.database, bus, store.clock)


def truncate_log(store, seq: int) -> None:
    """Remove the newest rows and restore the trigger, so that only the anchors reveal it."""
    removal = f"DELETE FROM audit WHERE seq >= {seq}"  # noqa: S608 - a number of this test
    with store.database.engine.begin() as connection:
        trigger = connection.execute(text("SELECT sql FROM sqlite_master WHERE name = 'audit_no_delete'")).scalar_one()
        for statement in ("DROP TRIGGER audit_no_delete", removal, trigger):
            connection.exec_driver_sql(statement)


def test_the_hash_is_written_to_the_servers_log(audit, alarms, caplog):
    """A copy outside the database shows later that the rows were changed."""
    with caplog.at_level("INFO", logger="gss"):
        AuditWatch(audit, alarms).verify()
    assert f"3 rows, last hash {audit.verify().last_hash}" in caplog.text


def raised(alarms: AlarmService) -> list[tuple[str, str, bool]]:
    """Return title, level and whether an action is stated, of each raised alarm."""
    return [(v.title, v.level.value, bool(v.action)) for v in alarms.opened() if v.row.state == "raised"]


def test_a_log_truncated_while_the_server_was_stopped_raises_an_alarm_at_start(store, audit, alarms):
    """The alarm is raised also if new rows have the numbers of the removed ones, and is cleared when the log is accepted."""
    truncate_log(store, 2)
    for number in range(4):
        audit.record("eve", "x.y", str(number), "done")
    watch = AuditWatch(audit, alarms)
    watch.verify()
    assert raised(alarms) == [("Audit log", "critical", True)]
    assert "gss audit accept" in watch.problem
    watch.compare()
    assert raised(alarms) == [("Audit log", "critical", True)]
    audit.accept("shell:ann", "tried")
    watch.compare()
    assert raised(alarms) == []
    assert "intact" in watch.state


def test_a_log_truncated_while_the_server_runs_raises_an_alarm(store, audit, alarms):
    """The comparison with the newest anchor detects the truncation and raises the alarm."""
    watch = AuditWatch(audit, alarms)
    watch.verify()
    watch.compare()
    assert (watch.problem, raised(alarms)) == ("", [])
    truncate_log(store, 3)
    watch.compare()
    assert raised(alarms) == [("Audit log", "critical", True)]
    assert "row 3" in watch.problem

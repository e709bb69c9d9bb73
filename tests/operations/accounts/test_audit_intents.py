"""Intents of changes that a killed process left open become audit rows."""

from __future__ import annotations

import os
import signal

from gss.operations.accounts.audit import AuditService
from gss.operations.accounts.audit_anchor import AnchorFile
from gss.operations.accounts.audit_intents import AuditIntents, Intent
from gss.store.audit import AuditFilter

AT = "2026-12-01T18:00:00.000Z"


def intent(action: str) -> Intent:
    return Intent("ann", "admin", action, "POST /x", "10.0.0.1", AT)


def test_open_intents_of_a_killed_process_are_recovered(database, clock, tmp_path):
    """Of three intents, one ended, one is open and one was written incompletely. The open one becomes an audit row with
    an unknown result."""
    folder, audit = tmp_path / "intents", AuditService(database, clock, AnchorFile(tmp_path / "anchors"))
    child = os.fork()
    if child == 0:
        intents = AuditIntents(folder, audit)
        first = intents.begin(intent("a.first"))
        intents.begin(intent("a.second"))
        intents.end(first)
        with next(folder.glob("*")).open("a") as file:
            file.write('{"begin": 3, "who": "a')
        os.kill(os.getpid(), signal.SIGKILL)
    os.waitpid(child, 0)
    assert AuditIntents(folder, audit).recover() == 1
    (row,) = audit.page(AuditFilter(), 9)
    assert (row.who, row.action, row.target, row.result, row.address) == (
        "ann",
        "a.second",
        "POST /x",
        "unknown",
        "10.0.0.1",
    )
    assert AT in row.detail
    assert AuditIntents(folder, audit).recover() == 0
    assert list(folder.iterdir()) == []


def test_the_intents_of_a_running_process_are_not_recovered(database, clock, tmp_path):
    """Open intents of a running API worker are not recovered. Closing it removes its file."""
    folder, audit = tmp_path / "intents", AuditService(database, clock, AnchorFile(tmp_path / "anchors"))
    running, other = AuditIntents(folder, audit), AuditIntents(folder, audit)
    number = running.begin(intent("a.b"))
    assert other.recover() == 0
    running.end(number)
    running.close()
    assert list(folder.iterdir()) == []

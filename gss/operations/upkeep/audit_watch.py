"""Verifies the audit log in the background: completely at start, and against its latest anchor once a minute."""

from __future__ import annotations

import logging
import threading

from gss.domain.limits import State
from gss.operations.accounts.audit import AuditService
from gss.operations.telemetry.alarm_text import STORE
from gss.operations.telemetry.alarms import AlarmService
from gss.operations.telemetry.limit_check import Key

log = logging.getLogger("gss.audit")
EVERY_S = 60.0
AUDIT: Key = (STORE, "audit log")


class AuditWatch:
    """Raises and ends the alarm of the audit log. ``state``: text for the health page; ``problem``: "" if the log is
    intact."""

    def __init__(self, audit: AuditService, alarms: AlarmService) -> None:
        self._audit, self._alarms = audit, alarms
        self.state, self.problem = "not verified yet", ""
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._run, name="audit", daemon=True)

    def start(self) -> None:
        """Start the background thread."""
        self._thread.start()

    def stop(self) -> None:
        """Stop the background thread. Do not wait for a complete verification in progress; it ends with the process."""
        self._stop.set()
        if self._thread.is_alive():
            self._thread.join(timeout=1)

    def verify(self) -> None:
        """Verify the log completely."""
        verdict = self._audit.verify()
        self._update(verdict.problem, f"{verdict.rows} rows, intact at the last complete verification")
        log.info("the audit log has %d rows, last hash %s", verdict.rows, verdict.last_hash)

    def compare(self) -> None:
        """Compare the log with its latest anchor. If the last check found a problem, verify the log completely, because
        only a complete verification shows that the problem is solved."""
        if self.problem:
            self.verify()
        else:
            self._update(self._audit.compare(), self.state)

    def _update(self, problem: str, state: str) -> None:
        self.problem, self.state = problem, state
        level, value = (State.CRITICAL, 1.0) if problem else (State.OK, 0.0)
        limit = f"is not intact: {problem}" if problem else ""
        self._alarms.watch(AUDIT, level, value, f"Audit log: {limit}; see Admin, Health", limit)

    def _run(self) -> None:
        work = self.verify
        while not self._stop.is_set():
            try:
                work()
            except Exception:  # a locked database must not end the watch
                log.exception("the audit log could not be verified")
            work = self.compare
            self._stop.wait(EVERY_S)

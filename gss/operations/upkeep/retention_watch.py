"""Starts a removal once a day, and raises alarms if the clock is in doubt or a removal waits for confirmation."""

from __future__ import annotations

from datetime import datetime

from gss.domain.limits import State
from gss.operations.clock import Now
from gss.operations.telemetry.alarm_text import STORE
from gss.operations.telemetry.alarms import AlarmService
from gss.operations.telemetry.limit_check import Key
from gss.operations.upkeep.clock_trust import DAY, HINT, ClockTrust
from gss.operations.upkeep.clocks import ClockWatch
from gss.operations.upkeep.retention import RetentionService

CLOCK: Key = (STORE, "server clock")
REMOVAL: Key = (STORE, "retention")


class RetentionWatch:
    """Advances the trusted time, and raises and ends the alarms of retention."""

    def __init__(self, trust: ClockTrust, retention: RetentionService, alarms: AlarmService) -> None:
        self._trust, self._retention, self._alarms = trust, retention, alarms

    def tick(self) -> None:
        """Update both alarms. Called about once a second."""
        clock_state = self._trust.tick()
        days = 0.0 if clock_state.trusted is None else round((clock_state.now - clock_state.trusted) / DAY, 2)
        text = f"Server clock: {clock_state.doubt}; retention is paused, nothing is deleted: {HINT}"
        limit = f"{clock_state.doubt}; retention is paused until it is confirmed" if clock_state.doubt else ""
        self._alarms.watch(CLOCK, State.WARNING if clock_state.doubt else State.OK, days, text, limit)
        waiting = self._retention.waiting()
        text = (
            f"Retention would remove {waiting}. Nothing was removed. Check the preview and confirm it (Admin, Storage)."
        )
        limit = f"waits for confirmation: would remove {waiting}" if waiting else ""
        self._alarms.watch(REMOVAL, State.WARNING if waiting else State.OK, 1.0 if waiting else 0.0, text, limit)


class DailyRetention:
    """Starts a removal once a day, except within an hour after the server's start or a jump of the clock, and while the
    clock is in doubt."""

    def __init__(self, retention: RetentionService, clocks: ClockWatch, trust: ClockTrust, now: Now) -> None:
        self._retention, self._clocks, self._trust, self._now = retention, clocks, trust, now
        self._next: datetime | None = None

    def tick(self) -> None:
        """Start a removal if it is due. Called about once a second."""
        now = self._now()
        if self._next is None:
            last = self._retention.last_run()
            self._next = now if last is None else last + DAY
        # After the clock was set back, the last run can be in the future. It must not delay the next run.
        self._next = min(self._next, now + DAY)
        if now < self._next or not self._clocks.steady() or self._trust.state().doubt:
            return
        self._next = now + DAY
        if self._retention.policy().deletes:
            self._retention.run_daily()

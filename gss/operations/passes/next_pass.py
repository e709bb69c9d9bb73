"""The next pass of the spacecraft over any ground station, for the header and the fleet."""

from __future__ import annotations

import threading
from datetime import datetime, timedelta

from gss.domain.errors import GssError
from gss.operations.clock import Now
from gss.operations.passes.pass_table import PassService
from gss.operations.passes.spacecraft import SpacecraftService
from gss.operations.passes.stations import StationService
from gss.orbit.passes import NextPass

AHEAD_DAYS = 1.0
CHECKED_EVERY = timedelta(seconds=20)
"""Interval at which the orbit and the stations are checked for changes."""
SEARCHED_EVERY = timedelta(minutes=10)
"""Interval between two searches. A search takes some tens of milliseconds per station."""


class NextPassWatch:
    """Calculates and caches the next pass. Thread-safe."""

    def __init__(self, spacecraft: SpacecraftService, stations: StationService, table: PassService, now: Now) -> None:
        self._spacecraft, self._stations, self._table, self._now = spacecraft, stations, table, now
        self._next = NextPass(None, "Not calculated yet.")
        self._basis: tuple[object, ...] | None = None
        self._checked = self._searched = now() - SEARCHED_EVERY
        self._lock = threading.Lock()

    def report(self) -> NextPass:
        """Return the current or next pass. It is calculated again if the orbit or a station changed, the pass is over, or
        ``SEARCHED_EVERY`` has passed."""
        now = self._now()
        with self._lock:
            over = self._next.at is not None and self._next.at.set <= now
            if over or abs(now - self._checked) >= CHECKED_EVERY:
                self._checked = now
                try:
                    self._update(now, over)
                except GssError as error:
                    self._next, self._basis = NextPass(None, str(error)), None
            return self._next

    def _update(self, now: datetime, over: bool) -> None:
        orbit = self._spacecraft.history(1)
        basis = (*(row.id for row in orbit), *((row.id, row.changed) for row in self._stations.list_all()))
        if basis == self._basis and not over and abs(now - self._searched) < SEARCHED_EVERY:
            return
        self._basis, self._searched = basis, now
        table = self._table.upcoming(AHEAD_DAYS)
        if table.passes:
            self._next = NextPass(table.passes[0].at)
        else:
            self._next = NextPass(None, table.problem or f"No pass in the next {AHEAD_DAYS * 24:g} hours.")

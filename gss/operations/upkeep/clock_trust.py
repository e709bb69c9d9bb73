"""Decides whether the server's clock may be used to choose data for deletion.

The database contains the last trusted time, which advances every ten minutes while the clock is plausible. The clock is
in doubt if it is behind the trusted time, or further ahead than a plausible downtime of the server. While it is in
doubt, retention and the rotation of backups delete nothing, even if a user starts them, until a user confirms the clock
or the clock is corrected. Without a stored trusted time, the clock is also in doubt.
"""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime, timedelta

from gss.domain.errors import BadInput, Conflict
from gss.operations.clock import Now, iso_z
from gss.operations.events import EventBus
from gss.store import choices
from gss.store import upkeep as store
from gss.store.engine import Database

KEEP_EVERY = timedelta(minutes=10)
BEHIND = timedelta(hours=1)
"""Maximum time by which the clock can be set back without being in doubt. Small corrections are normal."""
SEEN_WITHIN = timedelta(minutes=15)
"""Maximum difference between the time that a user confirms and the clock at the arrival of the confirmation."""
DAY = timedelta(days=1)
HINT = "check the server's date and time; if they are correct, confirm the clock (Admin, Storage, or gss retention --confirm-clock)"


@dataclass(frozen=True)
class ClockState:
    """State of the clock. ``trusted``: last trusted time, None if none is stored; ``doubt``: why the clock is in doubt,
    "" if it is plausible."""

    now: datetime
    trusted: datetime | None
    doubt: str


class ClockTrust:
    """Compares the clock with the last trusted time. ``pause``: longest plausible downtime of the server."""

    def __init__(self, database: Database, bus: EventBus, now: Now, pause: timedelta) -> None:
        self._database, self._bus, self._now, self._pause = database, bus, now, pause

    def start(self) -> None:
        """Initialize the trusted time if none is stored, from the latest stored row or, in an empty store, from the
        clock. Must be called before the server stores rows."""
        if self._trusted() is not None:
            return
        with self._database.unit_of_work() as session:
            newest = store.newest_row(session)
        self._store_trusted(newest or self._now(), "gss")

    def state(self) -> ClockState:
        """Compare the clock with the last trusted time and return the result."""
        now, trusted = self._now(), self._trusted()
        return ClockState(now, trusted, self._doubt(now, trusted))

    def tick(self) -> ClockState:
        """Advance the trusted time if the clock is plausible. Called about once a second."""
        clock_state = self.state()
        if (
            not clock_state.doubt
            and clock_state.trusted is not None
            and clock_state.now - clock_state.trusted >= KEEP_EVERY
        ):
            self._store_trusted(clock_state.now, "gss")
        return clock_state

    def require(self, action: str) -> None:
        """Raise Conflict if the clock is in doubt."""
        clock_state = self.state()
        if clock_state.doubt:
            trusted = iso_z(clock_state.trusted, "seconds") if clock_state.trusted else "not known"
            raise Conflict(
                f"{action}: nothing is deleted while the server's clock is in doubt",
                expected=f"a time up to {self._pause / DAY:g} days after the last trusted time, {trusted}",
                got=f"{iso_z(clock_state.now, 'seconds')}: {clock_state.doubt}",
                hint=HINT,
            )

    def confirm(self, displayed: datetime, *, user: str) -> ClockState:
        """Record that a user has checked the server's clock. ``displayed``: the time that the user saw. Raises BadInput
        if it differs from the clock."""
        now = self._now()
        if abs(now - displayed) > SEEN_WITHIN:
            raise BadInput(
                "the confirmed time differs from the server's clock",
                expected=f"within {SEEN_WITHIN / timedelta(minutes=1):g} minutes of {iso_z(now, 'seconds')}",
                got=iso_z(displayed, "seconds"),
                hint="reload the page and check the time",
            )
        before = self._trusted()
        self._store_trusted(now, user)
        text = f"The server's clock was confirmed by {user}: {iso_z(now, 'seconds')}"
        text += f"; last trusted time before: {iso_z(before, 'seconds')}" if before else ""
        self._bus.record("clock", "watch", text)
        return self.state()

    def _doubt(self, now: datetime, trusted: datetime | None) -> str:
        if trusted is None:
            return "no trusted time is stored"
        ahead = now - trusted
        if ahead > self._pause:
            return f"{ahead / DAY:.0f} days ahead of the last trusted time"
        if ahead < -BEHIND:
            return f"{-ahead / DAY:.1f} days behind the last trusted time"
        return ""

    def _trusted(self) -> datetime | None:
        with self._database.unit_of_work() as session:
            return choices.trusted_time(session)

    def _store_trusted(self, trusted: datetime, user: str) -> None:
        with self._database.unit_of_work() as session:
            choices.write(session, choices.TRUSTED_TIME, {"at": trusted.isoformat()}, self._now(), user)

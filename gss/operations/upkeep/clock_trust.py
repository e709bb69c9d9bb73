"""Decides whether the server's clock may be used to choose data for deletion.

The database holds the last trusted time: it advances every ten minutes while the clock is plausible, and not otherwise. The clock
is in doubt when it is further ahead of that time than a plausible pause of the server, or behind it. While it is in doubt neither
retention nor the rotation of backups deletes anything, also when a user starts them, until a user confirms the clock or it is
corrected. An unknown trusted time counts as in doubt.
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
"""A clock set back by less than this, as a correction, is not in doubt."""
SEEN_WITHIN = timedelta(minutes=15)
"""Maximum difference between the time that a person confirms and the clock when the confirmation arrives."""
DAY = timedelta(days=1)
HINT = "check the server's date and time; if they are right, confirm the clock (Admin, Storage, or gss retention --confirm-clock)"


@dataclass(frozen=True)
class ClockState:
    """``trusted`` None: not known. ``doubt``: why nothing is deleted; empty if the clock is plausible."""

    now: datetime
    trusted: datetime | None
    doubt: str


class ClockTrust:
    """Compares the clock with the last trusted time. ``pause``: longest plausible downtime of the server."""

    def __init__(self, database: Database, bus: EventBus, now: Now, pause: timedelta) -> None:
        self._database, self._bus, self._now, self._pause = database, bus, now, pause

    def start(self) -> None:
        """Initialize the trusted time, if none is stored, from the newest stored row, or from the clock if nothing is
        stored. Must be called before this start stores rows."""
        if self._trusted() is not None:
            return
        with self._database.unit_of_work() as session:
            newest = store.newest_row(session)
        self._keep(newest or self._now(), "gss")

    def state(self) -> ClockState:
        """Return the clock compared with the last trusted time."""
        now, trusted = self._now(), self._trusted()
        return ClockState(now, trusted, self._doubt(now, trusted))

    def tick(self) -> ClockState:
        """Advance the trusted time if the clock is plausible; called about once a second."""
        clock_state = self.state()
        if (
            not clock_state.doubt
            and clock_state.trusted is not None
            and clock_state.now - clock_state.trusted >= KEEP_EVERY
        ):
            self._keep(clock_state.now, "gss")
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
        """Record that a person has checked the server's clock. ``displayed``: the time that was shown to them. Raises BadInput if
        it differs from the clock."""
        now = self._now()
        if abs(now - displayed) > SEEN_WITHIN:
            raise BadInput(
                "the confirmed time differs from the server's clock",
                expected=f"within {SEEN_WITHIN / timedelta(minutes=1):g} minutes of {iso_z(now, 'seconds')}",
                got=iso_z(displayed, "seconds"),
                hint="reload the page and check the time",
            )
        before = self._trusted()
        self._keep(now, user)
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

    def _keep(self, moment: datetime, user: str) -> None:
        with self._database.unit_of_work() as session:
            choices.write(session, choices.TRUSTED_TIME, {"at": moment.isoformat()}, self._now(), user)

"""Whether the server's clock may decide what is old enough to delete.

The database holds the last trusted time: it advances every ten minutes while the clock is plausible, and not otherwise. The clock
is in doubt when it is further ahead of that time than a plausible pause of the server, or behind it. While in doubt nothing stored
is deleted automatically or by hand; a person confirms the clock, or it is set right. Unknown counts as in doubt.
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

NAME = "upkeep.trusted-time"
KEEP_EVERY = timedelta(minutes=10)
BEHIND = timedelta(hours=1)
"""A clock that was corrected by less than this is not behind."""
SEEN_WITHIN = timedelta(minutes=15)
"""The time that a person confirms may be this far from the clock's time when the confirmation arrives."""
DAY = timedelta(days=1)
HINT = "check the server's date and time; if they are right, confirm the clock (Admin, Storage, or gss retention --confirm-clock)"


@dataclass(frozen=True)
class ClockState:
    """``trusted`` None: not known. ``doubt``: why nothing is deleted; empty where the clock is plausible."""

    now: datetime
    trusted: datetime | None
    doubt: str


class ClockTrust:
    """Compares the clock with the last trusted time. ``pause``: the longest plausible time for which the server was off."""

    def __init__(self, database: Database, bus: EventBus, now: Now, pause: timedelta) -> None:
        self._database, self._bus, self._now, self._pause = database, bus, now, pause

    def start(self) -> None:
        """Begin with the newest stored row where no trusted time is stored yet, or with the clock where nothing is stored. To be
        called before this start stores rows of its own."""
        if self._trusted() is not None:
            return
        with self._database.unit_of_work() as session:
            newest = store.newest_row(session)
        self._keep(newest or self._now(), "gss")

    def state(self) -> ClockState:
        """The clock against the last trusted time."""
        now, trusted = self._now(), self._trusted()
        return ClockState(now, trusted, self._doubt(now, trusted))

    def tick(self) -> ClockState:
        """Let the trusted time follow a plausible clock; called about once a second."""
        found = self.state()
        if not found.doubt and found.trusted is not None and found.now - found.trusted >= KEEP_EVERY:
            self._keep(found.now, "gss")
        return found

    def require(self, what: str) -> None:
        """Conflict where the clock is in doubt."""
        found = self.state()
        if found.doubt:
            trusted = iso_z(found.trusted, "seconds") if found.trusted else "not known"
            raise Conflict(
                f"{what}: nothing is deleted while the server's clock is in doubt",
                expected=f"a time up to {self._pause / DAY:g} days after the last trusted one, {trusted}",
                got=f"{iso_z(found.now, 'seconds')}: {found.doubt}",
                hint=HINT,
            )

    def confirm(self, seen: datetime, *, user: str) -> ClockState:
        """A person has checked the server's clock. ``seen``: the time that was shown to them."""
        now = self._now()
        if abs(now - seen) > SEEN_WITHIN:
            raise BadInput(
                "the confirmed time is not that of the server's clock",
                expected=f"within {SEEN_WITHIN / timedelta(minutes=1):g} minutes of {iso_z(now, 'seconds')}",
                got=iso_z(seen, "seconds"),
                hint="load the page again and check the time",
            )
        before = self._trusted()
        self._keep(now, user)
        text = f"the server's clock was confirmed by {user}: {iso_z(now, 'seconds')}"
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
            rows = [row for row in choices.read(session, NAME) if row.name == NAME]
            return datetime.fromisoformat(rows[0].value["at"]) if rows else None

    def _keep(self, moment: datetime, user: str) -> None:
        with self._database.unit_of_work() as session:
            choices.write(session, NAME, {"at": moment.isoformat()}, self._now(), user)

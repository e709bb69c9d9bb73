"""The spacecraft that carries the unit: its active orbit, with source and age, and its earlier orbits."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Literal

from gss.domain.errors import BadInput, Conflict
from gss.operations.clock import Now
from gss.operations.events import EventBus
from gss.orbit.read_orbit import ReadOrbit, read_orbit, stored_orbit
from gss.orbit.trajectory import Trajectory, covers
from gss.store import passes as store
from gss.store.engine import Database
from gss.store.models import OrbitSet

HISTORY = 20
NEAREST = 5
"""Maximum number of imported orbits that are tried for a time in the past."""
DAY = timedelta(days=1)
WATCH_DAYS, WARNING_DAYS, REFUSED_DAYS = 3.0, 7.0, 14.0
"""Ages of a TLE, in days, at which its state changes. In a low orbit the error of predicted times is about a second
after three days and up to a minute after two weeks."""
OrbitState = Literal["ok", "watch", "warning", "critical"]


@dataclass(frozen=True)
class CurrentOrbit:
    """The active orbit. ``state`` and ``advice``: whether the orbit is recent enough, as a level and as a sentence."""

    row: OrbitSet
    orbit: Trajectory
    age_days: float
    state: OrbitState
    advice: str

    @property
    def plannable(self) -> bool:
        """True if the orbit is recent enough for arming pass plans."""
        return self.state != "critical"


class SpacecraftService:
    """Stores orbits and returns the active orbit, which is the one imported last."""

    def __init__(self, database: Database, bus: EventBus, now: Now) -> None:
        self._database, self._bus, self._now = database, bus, now
        self._lock = threading.Lock()
        self._read: tuple[int, Trajectory] | None = None

    def name(self, otherwise: str) -> str:
        """Return the name of the spacecraft, or ``otherwise`` if no orbit was imported."""
        rows = self.history(1)
        return rows[0].spacecraft if rows else otherwise

    def current(self) -> CurrentOrbit | None:
        """Return the active orbit and its age, None if no orbit was imported."""
        rows = self.history(1)
        if not rows:
            return None
        orbit = self._orbit(rows[0])
        return _judged(rows[0], orbit, self._now())

    def require(self) -> CurrentOrbit:
        """Return the active orbit. Raises Conflict if no orbit was imported."""
        orbit = self.current()
        if orbit is None:
            raise Conflict(
                "the orbit of the spacecraft is unknown",
                expected="a TLE, an OMM or an OEM",
                hint="Import one on the page Passes, or with gss passes orbit.",
            )
        return orbit

    def orbit_at(self, moment: datetime) -> tuple[str, Trajectory] | None:
        """Return the name of the spacecraft and an imported orbit that is valid at a time, None if there is none. If
        several orbits are valid, the active orbit is used, otherwise the orbit of the same spacecraft with the nearest
        epoch."""
        rows = self.history(1)
        if not rows:
            return None
        newest = self._orbit(rows[0])
        if covers(newest, moment):
            return rows[0].spacecraft, newest
        with self._database.unit_of_work() as session:
            earlier = store.nearest_orbits(session, rows[0].spacecraft, moment, NEAREST)
        for row in earlier:
            orbit = stored_orbit("tle" if row.kind == "tle" else "oem", row.text)
            if covers(orbit, moment):
                return row.spacecraft, orbit
        return None

    def history(self, limit: int = HISTORY) -> list[OrbitSet]:
        """Return the latest imported orbits, newest first."""
        with self._database.unit_of_work() as session:
            return store.newest_orbits(session, limit)

    def set(self, text: str, *, name: str, source: str, user: str) -> tuple[CurrentOrbit, ReadOrbit]:
        """Read an orbit file and make its orbit the active one. ``name``: name of the spacecraft; if it is "", the name in the
        file or the previous name is used. Raises BadInput if the file is not valid or its orbit has expired."""
        read, now = read_orbit(text), self._now()
        if read.orbit.end <= now:
            raise BadInput(
                "the orbit is too old",
                expected=f"an orbit that is valid at {now:%Y-%m-%d %H:%M} UTC",
                got=f"{read.source_format} of {read.orbit.epoch:%Y-%m-%d}, valid until {read.orbit.end:%Y-%m-%d}",
                hint="Import newer elements.",
            )
        before = self.history(1)
        spacecraft_name = " ".join(name.split()) or read.name or (before[0].spacecraft if before else "Spacecraft")
        row = OrbitSet(
            spacecraft=spacecraft_name[:80],
            kind=read.kind,
            source_format=read.source_format,
            source=source,
            text=read.text,
            epoch=read.orbit.epoch,
            user=user,
            added=now,
        )
        with self._database.unit_of_work() as session:
            store.add(session, row)
        current = _judged(row, read.orbit, now)
        self._bus.record("pass", current.state, f"{user} imported the orbit of {row.spacecraft}: {current.advice}")
        return current, read

    def _orbit(self, row: OrbitSet) -> Trajectory:
        with self._lock:
            if self._read is None or self._read[0] != row.id:
                self._read = (row.id, stored_orbit("tle" if row.kind == "tle" else "oem", row.text))
            return self._read[1]


def _judged(row: OrbitSet, orbit: Trajectory, now: datetime) -> CurrentOrbit:
    """Return the orbit with its age and an advice."""
    age_days = (now - row.epoch) / DAY
    if row.kind == "oem":
        left_days = (orbit.end - now) / DAY
        state: OrbitState = "ok" if left_days > 1 else "watch" if left_days > 0.25 else "critical"
        message = f"The ephemeris ends in {left_days:.1f} days" if left_days > 0 else "The ephemeris has ended"
    else:
        age = abs(age_days)
        state = "ok" if age <= WATCH_DAYS else "watch" if age <= WARNING_DAYS else "warning"
        state = "critical" if age > REFUSED_DAYS else state
        message = f"The elements are {age_days:.1f} days old" if age_days >= 0 else f"The epoch is {age:.1f} days ahead"
    remedy = {"critical": ". Pass plans cannot be armed; import newer elements.", "ok": "."}
    return CurrentOrbit(row, orbit, age_days, state, message + remedy.get(state, ". Import newer elements."))

"""The spacecraft that carries the unit: its orbit in use, with source and age, and the orbits before."""

from __future__ import annotations

import threading
from dataclasses import dataclass
from datetime import datetime, timedelta
from typing import Literal

from gss.domain.errors import BadInput, Conflict
from gss.operations.clock import Now
from gss.operations.events import EventBus
from gss.orbit.read_orbit import ReadOrbit, read_orbit, stored_orbit
from gss.orbit.trajectory import Trajectory
from gss.store import passes as store
from gss.store.engine import Database
from gss.store.models import OrbitSet

HISTORY = 20
NEAREST = 5
"""Imported orbits that are read for a time in the past."""
DAY = timedelta(days=1)
WATCH_DAYS, WARNING_DAYS, REFUSED_DAYS = 3.0, 7.0, 14.0
"""Age of a TLE in a low orbit: after three days times are off by about a second, after two weeks by up to a minute."""
OrbitState = Literal["ok", "watch", "warning", "critical"]


@dataclass(frozen=True)
class CurrentOrbit:
    """The orbit in use. ``state`` and ``advice``: whether it is recent enough, in words; ``plannable``: recent enough for arming
    pass plans."""

    row: OrbitSet
    orbit: Trajectory
    age_days: float
    state: OrbitState
    advice: str

    @property
    def plannable(self) -> bool:
        """True if pass plans may rely on it."""
        return self.state != "critical"


class SpacecraftService:
    """Stores orbits and returns the one in use."""

    def __init__(self, database: Database, bus: EventBus, now: Now) -> None:
        self._database, self._bus, self._now = database, bus, now
        self._lock = threading.Lock()
        self._read: tuple[int, Trajectory] | None = None

    def name(self, otherwise: str) -> str:
        """Return the name of the spacecraft of the orbit in use; another name if no orbit was imported."""
        rows = self.history(1)
        return rows[0].spacecraft if rows else otherwise

    def current(self) -> CurrentOrbit | None:
        """Return the orbit in use, with its age now; None if no orbit was imported."""
        rows = self.history(1)
        if not rows:
            return None
        orbit = self._orbit(rows[0])
        return _judged(rows[0], orbit, self._now())

    def require(self) -> CurrentOrbit:
        """As ``current``. Raises Conflict if no orbit was imported."""
        orbit = self.current()
        if orbit is None:
            raise Conflict(
                "the orbit of the spacecraft is not known",
                expected="a TLE, an OMM or an OEM",
                hint="Import one on the page Passes, or with gss passes orbit.",
            )
        return orbit

    def orbit_at(self, moment: datetime) -> tuple[str, Trajectory] | None:
        """Return name and orbit of the spacecraft if an imported orbit is defined at that time, for the place of a frame; else
        None. The one in use comes first, then those of the same spacecraft with the nearest epoch."""
        rows = self.history(1)
        if not rows:
            return None
        newest = self._orbit(rows[0])
        if newest.start <= moment <= newest.end:
            return rows[0].spacecraft, newest
        with self._database.unit_of_work() as session:
            earlier = store.nearest_orbits(session, rows[0].spacecraft, moment, NEAREST)
        for row in earlier:
            orbit = stored_orbit("tle" if row.kind == "tle" else "oem", row.text)
            if orbit.start <= moment <= orbit.end:
                return row.spacecraft, orbit
        return None

    def history(self, limit: int = HISTORY) -> list[OrbitSet]:
        """Return the newest orbits first."""
        with self._database.unit_of_work() as session:
            return store.newest_orbits(session, limit)

    def set(self, text: str, *, name: str, source: str, user: str) -> tuple[CurrentOrbit, ReadOrbit]:
        """Read an orbit file and use it from now on. ``name``: of the spacecraft, "" for that in the file, else the name before.
        Raises BadInput if the file is not valid or has no orbit near now."""
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
    """Return the orbit with its age and what to do about it."""
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

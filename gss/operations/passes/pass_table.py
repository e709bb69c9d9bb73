"""Passes of the coming days over all ground stations, with their line budget, and as a calendar."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime, timedelta

from gss.domain.errors import BadInput, GssError
from gss.operations.clock import Now
from gss.operations.passes.line_budget import LineBudget, LineBudgetService
from gss.operations.passes.spacecraft import CurrentOrbit, SpacecraftService
from gss.operations.passes.stations import StationService, ground_station
from gss.orbit.passes import OrbitPass, find_passes
from gss.store.models import Station

MAX_DAYS = 14.0
UNDER_WAY = timedelta(minutes=30)
"""Passes that began this long ago are still searched for, so that one under way has its true rise."""


@dataclass(frozen=True)
class ComingPass:
    """A pass, its station, and what the line can bring in it."""

    at: OrbitPass
    station: Station
    budget: LineBudget


@dataclass(frozen=True)
class PassTable:
    """Passes by rise. ``problem``: why there are none, "" otherwise."""

    current: CurrentOrbit | None
    stations: Sequence[Station]
    passes: Sequence[ComingPass]
    problem: str
    start: datetime
    days: float


class PassService:
    """Calculates coming passes."""

    def __init__(
        self, spacecraft: SpacecraftService, stations: StationService, budgets: LineBudgetService, now: Now
    ) -> None:
        self._spacecraft, self._stations, self._budgets, self._now = spacecraft, stations, budgets, now

    def coming(self, days: float, station_id: int | None = None) -> PassTable:
        """Return the passes under way or beginning within ``days``. Raises BadInput for other days than 0 to 14, NotFound for an
        unknown station. A missing or outdated orbit is a problem of the table, not an error."""
        if not 0 < days <= MAX_DAYS:
            raise BadInput("days are out of range", expected=f"above 0, at most {MAX_DAYS:g}", got=f"{days:g}")
        now = self._now()
        stations = self._stations.every() if station_id is None else [self._stations.get(station_id)]
        current = self._spacecraft.current()
        if current is None or not stations:
            problem = "No orbit was imported." if current is None else "There is no ground station."
            return PassTable(current, stations, [], problem, now, days)
        try:
            passes = [coming_pass for row in stations for coming_pass in self._over(current, row, now, days)]
        except GssError as error:
            return PassTable(current, stations, [], str(error), now, days)
        return PassTable(current, stations, sorted(passes, key=lambda coming_pass: coming_pass.at.rise), "", now, days)

    def at(self, station_id: int, moment: datetime) -> ComingPass:
        """Return the pass over a station at a time. Raises BadInput if the spacecraft is not in view then, Conflict without an
        orbit."""
        current, row = self._spacecraft.require(), self._stations.get(station_id)
        start = moment - UNDER_WAY
        for found_pass in find_passes(current.orbit, ground_station(row), start, moment + UNDER_WAY):
            if found_pass.rise <= moment + timedelta(seconds=1) and found_pass.set >= moment:
                return ComingPass(found_pass, row, self._budgets.of(row))
        raise BadInput(
            f"{current.row.spacecraft} is not in view of {row.name} at that time",
            expected="a time within a pass",
            got=f"{moment:%Y-%m-%d %H:%M:%S} UTC",
            hint="Choose a pass of the table.",
        )

    def _over(self, current: CurrentOrbit, row: Station, now: datetime, days: float) -> list[ComingPass]:
        budget = self._budgets.of(row)
        station_passes = find_passes(current.orbit, ground_station(row), now - UNDER_WAY, now + timedelta(days=days))
        return [ComingPass(station_pass, row, budget) for station_pass in station_passes if station_pass.set > now]

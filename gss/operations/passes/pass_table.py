"""Passes of the coming days over the ground stations, with their line budgets."""

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
"""The search begins this long before the present, so that the rise of a pass in progress is found."""


@dataclass(frozen=True)
class ComingPass:
    """A pass, its station, and the data rate of the station's line."""

    at: OrbitPass
    station: Station
    budget: LineBudget


@dataclass(frozen=True)
class PassTable:
    """Passes in order of rise. ``problem``: reason why they cannot be calculated, "" otherwise."""

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

    def upcoming(self, days: float, station_id: int | None = None) -> PassTable:
        """Return the passes that are in progress or begin within ``days``. Raises BadInput unless 0 < ``days`` ≤ 14, NotFound
        for an unknown station. A missing or outdated orbit is reported in ``problem`` and does not raise."""
        if not 0 < days <= MAX_DAYS:
            raise BadInput("days are out of range", expected=f"above 0, at most {MAX_DAYS:g}", got=f"{days:g}")
        now = self._now()
        stations = self._stations.list_all() if station_id is None else [self._stations.get(station_id)]
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
        """Return the pass over a station at a time. Raises BadInput if the spacecraft is not in view at that time, Conflict if
        there is no orbit."""
        current, row = self._spacecraft.require(), self._stations.get(station_id)
        start = moment - UNDER_WAY
        for orbit_pass in find_passes(current.orbit, ground_station(row), start, moment + UNDER_WAY):
            if orbit_pass.rise <= moment + timedelta(seconds=1) and orbit_pass.set >= moment:
                return ComingPass(orbit_pass, row, self._budgets.of(row))
        raise BadInput(
            f"{current.row.spacecraft} is not in view of {row.name} at that time",
            expected="a time within a pass",
            got=f"{moment:%Y-%m-%d %H:%M:%S} UTC",
            hint="Choose a pass of the table.",
        )

    def _over(self, current: CurrentOrbit, row: Station, now: datetime, days: float) -> list[ComingPass]:
        budget = self._budgets.of(row)
        orbit_passes = find_passes(current.orbit, ground_station(row), now - UNDER_WAY, now + timedelta(days=days))
        return [ComingPass(orbit_pass, row, budget) for orbit_pass in orbit_passes if orbit_pass.set > now]

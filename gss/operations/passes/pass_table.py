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
from gss.orbit.station import GroundStation
from gss.orbit.trajectory import Trajectory
from gss.store.models import Station

MAX_DAYS = 14.0
UNDER_WAY = timedelta(minutes=30)
"""The search begins this long before the present, so that the rise of a pass in progress is found."""
LONGER = (timedelta(hours=4), timedelta(days=1))
"""Searches around a pass that is longer. A pass of more than a day is returned with the limits of the last search."""


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
        orbit_pass = _pass_at(current.orbit, ground_station(row), moment)
        if orbit_pass is not None:
            return ComingPass(orbit_pass, row, self._budgets.of(row))
        raise BadInput(
            f"{current.row.spacecraft} is not in view of {row.name} at that time",
            expected="a time within a pass",
            got=f"{moment:%Y-%m-%d %H:%M:%S} UTC",
            hint="Choose a pass of the table.",
        )

    def _over(self, current: CurrentOrbit, row: Station, now: datetime, days: float) -> list[ComingPass]:
        budget, station = self._budgets.of(row), ground_station(row)
        found = find_passes(current.orbit, station, now - UNDER_WAY, now + timedelta(days=days))
        return [ComingPass(_complete(current.orbit, station, at), row, budget) for at in found if at.set > now]


def _pass_at(orbit: Trajectory, station: GroundStation, moment: datetime) -> OrbitPass | None:
    """Return the pass in progress at a time, None if there is none."""
    found = None
    for margin in (UNDER_WAY, *LONGER):
        passes = find_passes(orbit, station, moment - margin, moment + margin)
        found = next((at for at in passes if at.rise <= moment + timedelta(seconds=1) and at.set >= moment), None)
        if found is None or not (found.begins_before or found.ends_after):
            break
    return found


def _complete(orbit: Trajectory, station: GroundStation, part: OrbitPass) -> OrbitPass:
    """Return the whole pass of which a search found a part."""
    cut = part.begins_before or part.ends_after
    return (_pass_at(orbit, station, part.culmination) if cut else None) or part

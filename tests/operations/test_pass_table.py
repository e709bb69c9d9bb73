"""Passes longer than the margin of the search, and the share of a line that is content of downloads."""

from __future__ import annotations

from datetime import datetime, timedelta
from types import SimpleNamespace
from typing import Any, cast

import pytest

from gss.operations.passes.line_budget import ASSUMED_SHARE, LineBudgetService
from gss.operations.passes.pass_table import PassService
from gss.operations.passes.spacecraft import SpacecraftService
from gss.operations.passes.stations import StationService
from gss.orbit.station import GroundStation
from gss.store.models import Contact, Station, Transfer

STATION = GroundStation("Stellenbosch", -0.59215, 0.32926, 136.0, 0.0873)
MEGABYTE, BAUD, SHARE = 1_000_000, 115_200, 0.85
LENGTH = timedelta(seconds=MEGABYTE / (BAUD / 10 * SHARE))
LINE = "tcp://station-a:4001"


def half_day_elements(epoch: datetime) -> str:
    """Return elements of a circular orbit of half a sidereal day."""
    day = (epoch - datetime(epoch.year, 1, 1, tzinfo=epoch.tzinfo)) / timedelta(days=1) + 1
    lines = [
        f"1 25544U 98067A   {epoch:%y}{day:012.8f}  .00000000  00000-0  00000-0 0  999",
        "2 25544  55.0000 211.2001 0007417  17.6667  85.6398  2.0056000020248",
    ]
    return "".join(f"{x}{sum(int(c) if c.isdigit() else c == '-' for c in x) % 10}\n" for x in lines)


def test_a_pass_of_hours_has_its_rise_and_set(database: Any, bus: Any, clock: Any) -> None:
    """The table and the pass of a plan have the same times, before and during the pass."""
    spacecraft, stations = SpacecraftService(database, bus, clock), StationService(database, bus, clock)
    station = stations.create(STATION, "", BAUD, "", user="ann")
    spacecraft.set(half_day_elements(clock()), name="", source="", user="ann")
    link = cast(Any, SimpleNamespace(last_hello=None))
    table = PassService(spacecraft, stations, LineBudgetService(link, database), clock)
    coming = next(p.at for p in table.upcoming(3).passes if p.at.rise > clock() + timedelta(hours=1))
    assert coming.duration_s > 2 * 3600
    for moment in (coming.rise + timedelta(minutes=1), coming.culmination, coming.set - timedelta(minutes=1)):
        found = table.at(station.id, moment).at
        assert (found.rise, found.set) == (coming.rise, coming.set)
        assert (found.begins_before, found.ends_after) == (False, False)
    clock.at = coming.set - timedelta(minutes=5)
    in_progress = table.upcoming(1).passes[0].at
    assert (in_progress.rise, in_progress.set) == (coming.rise, coming.set)


@pytest.fixture
def store(database: Any, clock: Any) -> Any:
    """Function that stores a contact over a line with complete downloads of a megabyte, as (created, finished) after its
    start."""

    def add(url: str, *downloads: tuple[timedelta, timedelta], ended: timedelta | None = None) -> None:
        start = clock()
        with database.unit_of_work() as session:
            contact = Contact(url=url, started=start, ended=None if ended is None else start + ended)
            session.add(contact)
            session.flush()
            for created, finished in downloads:
                session.add(
                    Transfer(
                        contact_id=contact.id,
                        direction="down",
                        kind="frame",
                        target="0",
                        subject="frame",
                        state="verified",
                        size=MEGABYTE,
                        created=start + created,
                        finished=start + finished,
                    )
                )

    return add


def share(database: Any, line_url: str = LINE) -> tuple[float, int]:
    """Return the share of content and the number of downloads from which it was measured."""
    link = cast(Any, SimpleNamespace(last_hello=None))
    station = Station(name="A", line_url=line_url, line_baud=BAUD)
    budget = LineBudgetService(link, database).of(station)
    return round(budget.share, 3), budget.downloads


def test_waiting_downloads_do_not_lower_the_share(database: Any, store: Any) -> None:
    """Of downloads that are requested together, each waits for the one before."""
    store(LINE, *((timedelta(), (k + 1) * LENGTH) for k in range(6)))
    assert share(database) == (SHARE, 6)


def test_downloads_of_other_lines_later_contacts_and_known_content_are_not_measured(database: Any, store: Any) -> None:
    """A faster line, a pause until the next contact, and content that was already stored say nothing about this line."""
    store("tcp://station-b:4001", (timedelta(), LENGTH / 8))
    store(LINE, (timedelta(), LENGTH + timedelta(minutes=90)), ended=timedelta(minutes=10))
    store(LINE, (timedelta(hours=3), timedelta(hours=3, seconds=2)))
    assert share(database) == (ASSUMED_SHARE, 0)
    store(LINE, (timedelta(hours=4), timedelta(hours=4) + LENGTH))
    assert share(database) == (SHARE, 1)

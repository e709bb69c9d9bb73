"""A migrated database with a bus, and clocks that tests turn by hand."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from gss.device.dictionary_file import load_dictionary
from gss.domain.errors import NotPermitted
from gss.operations.commanding.abort_journal import AbortJournal
from gss.operations.commanding.authority import AuthorityService
from gss.operations.commanding.command_history import CommandHistory
from gss.operations.commanding.commanding import CommandService
from gss.operations.commanding.schedule import ScheduleService
from gss.operations.commanding.stack_runs import StackRunner
from gss.operations.commanding.stacks import StackService
from gss.operations.events import EventBus
from gss.operations.line.dispatcher import Dispatcher
from gss.operations.line.line_events import LineBatch, LineEventQueue
from gss.operations.line.link import LinkService
from gss.store.engine import Database, migrate, open_engine


class HandClock:
    """A clock that only moves when told."""

    def __init__(self) -> None:
        self.at = datetime(2026, 12, 1, 18, 0, tzinfo=UTC)

    def __call__(self) -> datetime:
        return self.at

    def forward(self, seconds: float) -> None:
        self.at += timedelta(seconds=seconds)


@pytest.fixture
def clock() -> HandClock:
    """The hand clock."""
    return HandClock()


@pytest.fixture
def database(tmp_path: Path) -> Iterator[Database]:
    """An SQLite database at the newest schema."""
    url = f"sqlite:///{tmp_path / 'gss.db'}"
    migrate(url)
    database = Database(open_engine(url))
    yield database
    database.close()


@pytest.fixture
def bus(database: Database, clock: HandClock) -> EventBus:
    """The bus on that database."""
    return EventBus(database, clock)


ENDED = ("completed", "rejected", "failed", "unknown", "withdrawn")


class Desk:
    """An operator's desk on a sensor in memory. ``now``: a clock that the caller owns; ``schedule``: it follows the line."""

    def __init__(
        self, sensor: Any, database: Database, bus: EventBus, folder: Path, now: Callable[[], datetime], schedule: bool
    ) -> None:
        self.sensor, self.bus = sensor, bus
        self.events = LineEventQueue(now, sensor.monotonic_s)
        self.link = LinkService(
            load_dictionary(), database, bus, folder / "captures", now, sensor.monotonic_s, self.events
        )
        self.authority = AuthorityService(database, bus, now)
        self.refused: set[str] = set()
        journal = AbortJournal(folder / "aborts.jsonl")
        self.commands = CommandService(self.link, database, bus, now, self.authority, self._permits, journal)
        self.history = CommandHistory(database)
        self.stacks = StackService(self.link, self.commands, database, now)
        self.runs = StackRunner(self.stacks, self.link, self.commands, database, bus, now, sensor.monotonic_s)
        self.schedule = ScheduleService(self.link, self.commands, bus, now)
        self.schedule_hears = schedule
        subscribers = [self.link.handle, self.commands.handle, self.runs.handle, self._schedule]
        self.dispatcher = Dispatcher(self.events, bus, sensor.monotonic_s, subscribers)
        sensor.keep_pace_with(self.events)

    def _permits(self, user: str, permission: str) -> None:
        if user in self.refused:
            raise NotPermitted("no", got=f"{user} {permission}")

    def _schedule(self, batch: LineBatch) -> None:
        if self.schedule_hears:
            self.schedule.handle(batch)

    def start(self) -> Desk:
        """Open the line and wait for the sensor."""
        self.commands.start()
        self.runs.start()
        self.dispatcher.start()
        self.link.start()
        self.link.open_later(self.sensor.url)
        self.wait(lambda: self.link.hello is not None and self.link.session.housekeeping is not None)
        return self

    def stop(self) -> None:
        """Give the line back."""
        self.runs.shut_down()
        self.link.stop()
        self.dispatcher.stop()

    def wait(self, done: Callable[[], bool]) -> None:
        """Until something holds; the real time is only the limit after which a broken thing is given up."""
        limit_s = time.monotonic() + 30
        while not done():
            assert time.monotonic() < limit_s, [event.text for event in self.bus.after(0, 1000)][-5:]
            time.sleep(0.002)

    def send(self, name: str, *, confirm: str = "", user: str = "ann", **arguments: Any) -> Any:
        """A command from the form."""
        return self.commands.send(name, arguments, confirm=confirm, user=user, source="form")

    def end(self, row: Any) -> Any:
        """The row of a command after its end."""
        self.wait(lambda: self.commands.get(row.id).result in ENDED)
        return self.commands.get(row.id)

    def run_ends(self, run: Any) -> Any:
        """The row of a stack's run after its end."""
        self.wait(lambda: self.runs.get(run.id).finished is not None)
        return self.runs.get(run.id)


@pytest.fixture
def make_desk(sensor_in_memory, database, bus, clock, tmp_path) -> Iterator[Callable[..., Desk]]:
    """Desks, one after the other on the same store; the line is given back at the end."""
    made: list[Desk] = []

    def make(
        sensor: Any = None, now: Callable[[], datetime] | None = None, schedule: bool = False, **identity: Any
    ) -> Desk:
        if made:
            made[-1].stop()
        made.append(Desk(sensor or sensor_in_memory(**identity), database, bus, tmp_path, now or clock, schedule))
        return made[-1].start()

    yield make
    for desk in made:
        desk.stop()

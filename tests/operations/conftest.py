"""Migrated database with an event bus, a clock that tests set, and an operator console."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from gss.domain.errors import NotPermitted
from gss.instruments.dictionary.read_dictionary import load_dictionary
from gss.instruments.registry import Registry
from gss.instruments.roles import default_roles
from gss.operations.commanding.abort_journal import AbortJournal
from gss.operations.commanding.authority import AuthorityService
from gss.operations.commanding.command_history import CommandHistory
from gss.operations.commanding.commanding import CommandService
from gss.operations.commanding.schedule import ScheduleService
from gss.operations.events import EventBus
from gss.operations.line.dispatcher import Dispatcher, LineEventQueue
from gss.operations.line.line_events import LineBatch
from gss.operations.line.link import LinkService
from gss.operations.procedures.conditions import Conditions
from gss.operations.procedures.procedures import ProcedureService
from gss.operations.procedures.runs import ProcedureRunner
from gss.operations.telemetry.telemetry import TelemetryService
from gss.store.engine import Database, open_engine
from gss.store.migration import migrate


class ManualClock:
    """Clock that advances only when a test advances it."""

    def __init__(self) -> None:
        self.at = datetime(2026, 12, 1, 18, 0, tzinfo=UTC)

    def __call__(self) -> datetime:
        return self.at

    def forward(self, seconds: float) -> None:
        self.at += timedelta(seconds=seconds)


@pytest.fixture
def clock() -> ManualClock:
    """Manual clock."""
    return ManualClock()


@pytest.fixture
def database(tmp_path: Path) -> Iterator[Database]:
    """SQLite database with the newest schema."""
    url = f"sqlite:///{tmp_path / 'gss.db'}"
    migrate(url)
    database = Database(open_engine(url))
    yield database
    database.close()


@pytest.fixture
def bus(database: Database, clock: ManualClock) -> EventBus:
    """Event bus of the database."""
    return EventBus(database, clock)


ENDED = ("completed", "rejected", "failed", "unknown", "withdrawn")


class OperatorConsole:
    """An operator's commanding services with a sensor in memory.

    ``now``: clock; ``schedule``: the schedule service subscribes to the link.
    """

    def __init__(
        self, sensor: Any, database: Database, bus: EventBus, folder: Path, now: Callable[[], datetime], schedule: bool
    ) -> None:
        self.sensor, self.bus = sensor, bus
        self.events = LineEventQueue(now, sensor.monotonic_s)
        self.link = LinkService(
            load_dictionary(),
            default_roles(load_dictionary()),
            database,
            bus,
            folder / "captures",
            now,
            sensor.monotonic_s,
            self.events,
        )
        self.authority = AuthorityService(database, bus, now)
        self.refused: set[str] = set()
        journal = AbortJournal(folder / "aborts.jsonl")
        self.commands = CommandService(self.link, database, bus, now, self.authority, self._permits, journal)
        self.history = CommandHistory(database)
        self.schedule = ScheduleService(self.link, self.commands, bus, now)
        self.telemetry = TelemetryService(
            load_dictionary(),
            database,
            bus,
            now,
            lambda: None,
            lambda: True,
            default_roles(load_dictionary()).quantities.status,
        )
        unit = Registry(folder / "instruments").get("cubestar")
        self.procedures = ProcedureService(self.link, unit, self.telemetry.derived, database, now)
        conditions = Conditions(self.telemetry)
        self.procedure_runs = ProcedureRunner(self.procedures, conditions, self.link, self.commands, database, bus, now)
        self.schedule_subscribed = schedule
        subscribers = [
            self.link.handle,
            self.telemetry.handle,
            self.commands.handle,
            self.procedure_runs.handle,
            self._schedule,
        ]
        self.dispatcher = Dispatcher(self.events, bus, sensor.monotonic_s, subscribers)
        sensor.keep_pace_with(self.events)

    def _permits(self, user: str, permission: str) -> None:
        if user in self.refused:
            raise NotPermitted("no", got=f"{user} {permission}")

    def _schedule(self, batch: LineBatch) -> None:
        if self.schedule_subscribed:
            self.schedule.handle(batch)

    def start(self) -> OperatorConsole:
        """Open the link and wait for the sensor."""
        self.commands.start()
        self.procedure_runs.start()
        self.dispatcher.start()
        self.link.start()
        self.link.open_later(self.sensor.url)
        self.wait(lambda: self.link.hello is not None and self.link.session.housekeeping is not None)
        return self

    def stop(self) -> None:
        """Close the link."""
        self.procedure_runs.shut_down()
        self.link.stop()
        self.dispatcher.stop()

    def wait(self, done: Callable[[], bool]) -> None:
        """Wait until ``done()`` is true. The timeout in real time only limits how long a failing test runs."""
        limit_s = time.monotonic() + 30
        while not done():
            assert time.monotonic() < limit_s, [event.text for event in self.bus.after(0, 1000)][-5:]
            time.sleep(0.002)

    def send(self, name: str, *, confirm: str = "", user: str = "ann", **arguments: Any) -> Any:
        """Send a command as the command form does."""
        return self.commands.send(name, arguments, confirm=confirm, user=user, source="form")

    def end(self, row: Any) -> Any:
        """Return the row of a command after its end."""
        self.wait(lambda: self.commands.get(row.id).result in ENDED)
        return self.commands.get(row.id)

    def run_ends(self, run: Any) -> Any:
        """Return the row of a procedure's run after its end."""
        self.wait(lambda: self.procedure_runs.get(run.id).finished is not None)
        return self.procedure_runs.get(run.id)


@pytest.fixture
def make_console(sensor_in_memory, database, bus, clock, tmp_path) -> Iterator[Callable[..., OperatorConsole]]:
    """Factory of consoles that use the same store one after another. Each closes its link at the end."""
    made: list[OperatorConsole] = []

    def make(
        sensor: Any = None, now: Callable[[], datetime] | None = None, schedule: bool = False, **identity: Any
    ) -> OperatorConsole:
        if made:
            made[-1].stop()
        made.append(
            OperatorConsole(sensor or sensor_in_memory(**identity), database, bus, tmp_path, now or clock, schedule)
        )
        return made[-1].start()

    yield make
    for console in made:
        console.stop()


@pytest.fixture
def console(make_console: Callable[..., OperatorConsole]) -> OperatorConsole:
    """Operator console whose sensor has sent housekeeping."""
    new_console = make_console()
    new_console.wait(lambda: new_console.telemetry.newest_values("housekeeping") is not None)
    return new_console

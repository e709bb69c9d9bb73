"""A ground station in this process with a sensor in memory, which both use the sensor's simulated clock."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import pytest

from gss.instruments.dictionary.read_dictionary import load_dictionary
from gss.instruments.roles import default_roles
from gss.operations.commanding.abort_journal import AbortJournal
from gss.operations.commanding.authority import AuthorityService
from gss.operations.commanding.commanding import CommandService
from gss.operations.contacts.contacts import ContactService
from gss.operations.events import EventBus
from gss.operations.line.dispatcher import Dispatcher, LineEventQueue
from gss.operations.line.link import LinkService
from gss.operations.line.raw_capture import Retention
from gss.operations.telemetry.alarms import AlarmService
from gss.operations.telemetry.telemetry import TelemetryService
from gss.store.engine import Database

DAWN = datetime(2026, 12, 1, 18, 0, tzinfo=UTC)


class Station:
    """Link, telemetry, commands, alarms and contacts. ``spoil`` modifies each block of received bytes."""

    def __init__(self, sensor: Any, database: Database, folder: Path, retention: Retention) -> None:
        self.sensor, self.database, self.folder = sensor, database, folder / "captures"
        self.dictionary = load_dictionary()
        self.spoil: Callable[[bytes], bytes] = lambda data: data
        self._read, sensor.read = sensor.read, self.read
        self.bus = EventBus(database, self.now)
        parts = (self.dictionary, database, self.bus)
        self.events = LineEventQueue(self.now, sensor.monotonic_s)
        self.link = LinkService(
            self.dictionary,
            default_roles(self.dictionary),
            *parts[1:],
            self.folder,
            self.now,
            sensor.monotonic_s,
            self.events,
            retention=retention,
        )
        self.room = True
        self.telemetry = TelemetryService(
            *parts,
            self.now,
            lambda: self.link.contact_id,
            lambda: self.room,
            default_roles(self.dictionary).quantities.status,
        )
        self.alarms = AlarmService(self.dictionary, self.telemetry, self.link, database, self.bus, self.now)
        self.commands = CommandService(
            self.link,
            database,
            self.bus,
            self.now,
            AuthorityService(database, self.bus, self.now),
            lambda user, permission: None,
            AbortJournal(folder / "aborts.jsonl"),
        )
        self.contacts = ContactService(self.link, self.alarms, database, self.bus, self.folder, self.now, lambda: None)
        subscribers = [
            self.link.handle,
            self.telemetry.handle,
            self.commands.handle,
            self.alarms.handle,
            self.contacts.handle,
        ]
        self.dispatcher = Dispatcher(self.events, self.bus, sensor.monotonic_s, subscribers)
        sensor.keep_pace_with(self.events)
        self.dispatcher.start()
        self.link.start()

    def now(self) -> datetime:
        """Return the time of the sensor's clock."""
        return DAWN + timedelta(seconds=self.sensor.now_s)

    def read(self, *args: Any) -> bytes:
        """Return received bytes, modified by ``spoil``."""
        return self.spoil(self._read(*args))

    def open(self) -> int:
        """Open the link, wait for the sensor, and return the contact's id."""
        self.link.open_later(self.sensor.url)
        self.wait(lambda: self.link.hello is not None)
        assert self.link.contact_id is not None
        return self.link.contact_id

    def close(self) -> None:
        """Close the link and wait for the contact's end."""
        contact_id = self.link.contact_id
        self.link.close()
        self.wait(lambda: self.link.contact_id is None)
        if contact_id is not None:
            self.wait(lambda: any(e.text.startswith("Line closed") for e in self.bus.after(0, 1000)))

    def stop(self) -> None:
        """Close the link."""
        self.link.stop()
        self.dispatcher.stop()

    def listen(self, seconds: float) -> None:
        """Advance the sensor's time by ``seconds``."""
        until_s = self.sensor.now_s + seconds
        self.wait(lambda: self.sensor.now_s >= until_s)

    def command(self, name: str, **arguments: Any) -> Any:
        """Send a command and wait for its end."""
        row = self.commands.send(name, arguments, confirm=name, user="ann", source="form")
        self.wait(lambda: self.commands.get(row.id).finished is not None)
        return self.commands.get(row.id)

    def wait(self, done: Callable[[], bool]) -> None:
        """Wait until ``done()`` is true. The timeout in real time only limits how long a failing test runs."""
        limit_s = time.monotonic() + 60
        while not done():
            assert time.monotonic() < limit_s, [event.text for event in self.bus.after(0, 1000)][-5:]
            time.sleep(0.002)


@pytest.fixture
def make_station(sensor_in_memory, database, tmp_path) -> Iterator[Callable[..., Station]]:
    """Factory of stations. Each closes its link at the end."""
    made: list[Station] = []

    def make(retention: Retention | None = None) -> Station:
        made.append(Station(sensor_in_memory(), database, tmp_path, retention or Retention()))
        return made[-1]

    yield make
    for station in made:
        station.stop()


@pytest.fixture
def station(make_station) -> Station:
    """One station."""
    return make_station()

"""Clocks that jump, the server's and the device's: no false alarm, no hidden silence, no gap that is none, no wrong moment."""

from __future__ import annotations

from datetime import datetime, timedelta

import pytest

from gss.device.dictionary_file import load_dictionary
from gss.device.session_events import Telemetry
from gss.operations.commanding.abort_journal import AbortJournal
from gss.operations.commanding.authority import AuthorityService
from gss.operations.commanding.commanding import CommandService
from gss.operations.commanding.schedule import ScheduleService
from gss.operations.line.contacts import ContactService
from gss.operations.line.line_events import LineBatch, LineEventQueue
from gss.operations.line.link import LinkService
from gss.operations.telemetry.alarms import SIGNAL_LOST_AFTER_S, AlarmService
from gss.operations.telemetry.telemetry import TelemetryService
from gss.operations.upkeep.clocks import ClockWatch
from gss.store import devices

DICTIONARY = load_dictionary()
DAY_S, HOUR_S = 86_400.0, 3600.0
JUMPS = pytest.mark.parametrize("jump_s", [DAY_S, -HOUR_S], ids=["a day forward", "an hour back"])


class Room:
    """Everything that keeps moments, on an open line, with a clock that can be set and one that cannot."""

    def __init__(self, database, bus, clock, folder) -> None:
        self.clock, self.database, self.bus, self.mono_s, self.device_s = clock, database, bus, 50.0, 1000.0
        self.link = LinkService(
            DICTIONARY, database, bus, folder, clock, lambda: self.mono_s, LineEventQueue(clock, lambda: self.mono_s)
        )
        self.telemetry = TelemetryService(DICTIONARY, database, bus, clock, lambda: self.contact, lambda: True)
        self.alarms = AlarmService(DICTIONARY, self.telemetry, self.link, database, bus, clock)
        commands = CommandService(
            self.link,
            database,
            bus,
            clock,
            AuthorityService(database, bus, clock),
            lambda *_: None,
            AbortJournal(folder / "aborts.jsonl"),
        )
        self.schedule = ScheduleService(self.link, commands, bus, clock)
        self.removed_before: datetime | None = None
        self.contacts = ContactService(
            self.link, self.alarms, database, bus, folder, clock, lambda: self.removed_before
        )
        jumped = [self.alarms.clock_jumped, self.schedule.clock_jumped]
        self.clocks = ClockWatch(bus, clock, lambda: self.mono_s, jumped)
        with database.unit_of_work() as session:
            self.contact = devices.open_contact(session, "x", clock(), "c").id
        self.link.line_is_open, self.link.contact.is_open, self.link.contact.contact_id = True, True, self.contact

    def live(self, seconds: int, heard: bool = True) -> None:
        """So many seconds, each with housekeeping or silent, and a look of the ticker."""
        for _ in range(seconds):
            self.clock.forward(1.0)
            self.mono_s, self.device_s = self.mono_s + 1.0, self.device_s + 1.0
            if heard:
                values = {"cycle_running": False, "supply_3v3_v": 3.3, "uptime_s": self.device_s}
                packets = LineBatch(
                    (Telemetry("housekeeping", self.device_s, 0, values, values),), self.clock(), self.mono_s
                )
                self.alarms.handle(packets.with_derived(self.telemetry.handle(packets)))
                self.schedule.handle(packets)
            self.tick()

    def tick(self) -> None:
        self.clocks.tick()
        self.alarms.tick()

    def state(self) -> str:
        return next(v.state for v in self.telemetry.values() if v.definition.name == "supply_3v3_v")


@pytest.fixture
def room(database, bus, clock, tmp_path):
    return Room(database, bus, clock, tmp_path)


@JUMPS
def test_a_jump_is_told_and_raises_no_alarm_and_makes_nothing_stale(room, jump_s):
    """While packets come each second the jump is an event and nothing else."""
    room.live(10)
    room.clock.forward(jump_s)
    room.tick()
    assert (room.alarms.opened(), room.state()) == ([], "ok")
    room.live(5)
    assert (room.alarms.opened(), room.state()) == ([], "ok")
    (told,) = [event for event in room.bus.after(0, 100) if event.kind == "clock"]
    assert told.data["jump_s"] == jump_s
    assert (room.clocks.steady(), room.clocks.last_jump_s) == (False, jump_s)


@JUMPS
def test_silence_is_found_as_fast_as_without_the_jump(room, jump_s):
    """A clock that was set back an hour must not hide an hour of silence."""
    room.live(10)
    room.clock.forward(jump_s)
    room.live(int(SIGNAL_LOST_AFTER_S), heard=False)
    assert room.alarms.opened() == []
    room.live(1, heard=False)
    assert [view.title for view in room.alarms.opened()] == ["Loss of signal"]
    room.live(20, heard=False)
    assert room.state() == "stale"
    room.live(1)
    assert room.alarms.opened()[0].row.state == "cleared"


@JUMPS
def test_the_correlation_of_the_clocks_is_begun_anew(room, jump_s):
    """No command is planned with moments of two clocks; three packets later it is right again."""
    room.live(30)
    before = room.schedule.clock()
    assert before.utc_of(room.device_s) == pytest.approx(room.clock().timestamp(), abs=0.2)
    room.clock.forward(jump_s)
    room.tick()
    assert room.schedule.clock() is None
    room.live(4)
    assert room.schedule.clock().utc_of(room.device_s) == pytest.approx(room.clock().timestamp(), abs=0.2)


def test_a_jump_of_the_devices_clock_is_begun_anew_too(room):
    """Forward by a day and back by an hour on board, without a word of the device."""
    for jump_s in (DAY_S, -HOUR_S):
        room.live(10)
        room.device_s += jump_s
        room.live(10)
        assert room.schedule.clock().utc_of(room.device_s) == pytest.approx(room.clock().timestamp(), abs=0.2)
        assert (room.alarms.opened(), room.clocks.last_jump_s) == ([], None)


@JUMPS
def test_the_record_of_a_contact_over_a_jump_is_whole(room, jump_s):
    """The device's clock shows that nothing is missing; what really is missing after the jump is still found; no contact ends
    before it began."""
    room.live(20)
    room.clock.forward(jump_s)
    room.live(20)
    check = room.contacts.record(room.contact)
    assert (check.held, check.expected, check.gaps, check.late) == (40, 40, (), ())
    room.live(7, heard=False)
    room.live(10)
    check = room.contacts.record(room.contact)
    assert [(gap.missing, gap.explained) for gap in check.gaps] == [(7, False)]
    with room.database.unit_of_work() as session:
        devices.update_contact(session, room.contact, ended=room.clock())
    with room.database.unit_of_work() as session:
        row, _ = devices.get_contact(session, room.contact)
    assert row.ended >= row.started
    assert room.contacts.detail(room.contact).duration_s >= 0


@JUMPS
def test_plots_over_a_jump_have_every_value_in_order_of_time(room, jump_s):
    """The archive answers with ascending moments, each value once."""
    room.live(20)
    room.clock.forward(jump_s)
    room.live(20)
    span = timedelta(days=3)
    found = room.telemetry.archive.history(["uptime_s"], room.clock() - span, room.clock() + span, 500)
    times = list(found[0].t)
    assert times == sorted(times)
    assert len(times) == 40


def test_gaps_that_retention_made_have_their_cause(room):
    """Thinned packets are no loss of the line."""
    room.live(5)
    room.live(9, heard=False)
    room.live(5)
    assert not room.contacts.record(room.contact).gaps[0].explained
    room.removed_before = room.clock() + timedelta(days=1)
    (gap,) = room.contacts.record(room.contact).gaps
    assert (gap.explained, gap.cause.startswith("removed by retention")) == (True, True)


def test_small_corrections_are_no_jumps(room):
    """What a time service does all day is not told."""
    for _ in range(20):
        room.live(1)
        room.clock.forward(0.4)
    assert room.clocks.last_jump_s is None

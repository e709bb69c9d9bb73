"""Clock jumps of server and device cause no false alarms or gaps, hide no silence, and give no wrong times."""

from __future__ import annotations

from datetime import datetime, timedelta

import pytest

from gss.device.session_events import Telemetry
from gss.instruments.dictionary.read_dictionary import load_dictionary
from gss.instruments.roles import default_roles
from gss.operations.commanding.abort_journal import AbortJournal
from gss.operations.commanding.authority import AuthorityService
from gss.operations.commanding.commanding import CommandService
from gss.operations.commanding.schedule import ScheduleService
from gss.operations.contacts.contacts import ContactService
from gss.operations.line.dispatcher import LineEventQueue
from gss.operations.line.line_events import LineBatch
from gss.operations.line.link import LinkService
from gss.operations.telemetry.alarms import AlarmService
from gss.operations.telemetry.silence import SIGNAL_LOST_AFTER_S
from gss.operations.telemetry.telemetry import TelemetryService
from gss.operations.upkeep.clocks import ClockWatch
from gss.store import devices

DICTIONARY = load_dictionary()
DAY_S, HOUR_S = 86_400.0, 3600.0
JUMPS = pytest.mark.parametrize("jump_s", [DAY_S, -HOUR_S], ids=["a day forward", "an hour back"])


class ClockHarness:
    """All services that store times, with an open link, a wall clock that can be set and a monotonic clock."""

    def __init__(self, database, bus, clock, folder) -> None:
        self.clock, self.database, self.bus, self.mono_s, self.device_s = clock, database, bus, 50.0, 1000.0
        self.link = LinkService(
            DICTIONARY,
            default_roles(DICTIONARY),
            database,
            bus,
            folder,
            clock,
            lambda: self.mono_s,
            LineEventQueue(clock, lambda: self.mono_s),
        )
        self.telemetry = TelemetryService(
            DICTIONARY,
            database,
            bus,
            clock,
            lambda: self.contact,
            lambda: True,
            default_roles(DICTIONARY).quantities.status,
        )
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

    def live(self, seconds: int, received: bool = True) -> None:
        """Simulate ``seconds`` seconds with or without housekeeping, each with one check of the ticker."""
        for _ in range(seconds):
            self.clock.forward(1.0)
            self.mono_s, self.device_s = self.mono_s + 1.0, self.device_s + 1.0
            if received:
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
        return next(v.state for v in self.telemetry.values() if v.name == "supply_3v3_v")


@pytest.fixture
def harness(database, bus, clock, tmp_path):
    return ClockHarness(database, bus, clock, tmp_path)


@JUMPS
def test_a_clock_jump_is_reported_without_alarms_or_stale_values(harness, jump_s):
    """If packets arrive each second, the only effect of a clock jump is an event."""
    harness.live(10)
    harness.clock.forward(jump_s)
    harness.tick()
    assert (harness.alarms.opened(), harness.state()) == ([], "ok")
    harness.live(5)
    assert (harness.alarms.opened(), harness.state()) == ([], "ok")
    (reported,) = [event for event in harness.bus.after(0, 100) if event.kind == "clock"]
    assert reported.data["jump_s"] == jump_s
    assert (harness.clocks.steady(), harness.clocks.last_jump_s) == (False, jump_s)


@JUMPS
def test_silence_is_detected_as_fast_as_without_the_jump(harness, jump_s):
    """Loss of signal is detected as fast as without a clock jump."""
    harness.live(10)
    harness.clock.forward(jump_s)
    harness.live(int(SIGNAL_LOST_AFTER_S), received=False)
    assert harness.alarms.opened() == []
    harness.live(1, received=False)
    assert [view.title for view in harness.alarms.opened()] == ["Loss of signal"]
    harness.live(20, received=False)
    assert harness.state() == "stale"
    harness.live(1)
    assert harness.alarms.opened()[0].row.state == "cleared"


@JUMPS
def test_the_correlation_of_the_clocks_restarts_after_a_jump(harness, jump_s):
    """After a clock jump the correlation is invalid, so that no command is planned with it, and is valid again after four
    packets."""
    harness.live(30)
    before = harness.schedule.clock()
    assert before.utc_of(harness.device_s) == pytest.approx(harness.clock().timestamp(), abs=0.2)
    harness.clock.forward(jump_s)
    harness.tick()
    assert harness.schedule.clock() is None
    harness.live(4)
    assert harness.schedule.clock().utc_of(harness.device_s) == pytest.approx(harness.clock().timestamp(), abs=0.2)


def test_a_jump_of_the_devices_clock_restarts_the_correlation_too(harness):
    """After a jump of the device's clock without a report, the correlation follows the new time."""
    for jump_s in (DAY_S, -HOUR_S):
        harness.live(10)
        harness.device_s += jump_s
        harness.live(10)
        assert harness.schedule.clock().utc_of(harness.device_s) == pytest.approx(harness.clock().timestamp(), abs=0.2)
        assert (harness.alarms.opened(), harness.clocks.last_jump_s) == ([], None)


@JUMPS
def test_the_record_of_a_contact_over_a_jump_is_complete(harness, jump_s):
    """A clock jump causes no gap in the record of a contact, packets missing after it are detected, and the contact does
    not end before its start."""
    harness.live(20)
    harness.clock.forward(jump_s)
    harness.live(20)
    check = harness.contacts.record(harness.contact)
    assert (check.held, check.expected, check.gaps, check.late) == (40, 40, (), ())
    harness.live(7, received=False)
    harness.live(10)
    check = harness.contacts.record(harness.contact)
    assert [(gap.missing, gap.explained) for gap in check.gaps] == [(7, False)]
    with harness.database.unit_of_work() as session:
        devices.update_contact(session, harness.contact, ended=harness.clock())
    with harness.database.unit_of_work() as session:
        row, _ = devices.get_contact(session, harness.contact)
    assert row.ended >= row.started
    assert harness.contacts.detail(harness.contact).duration_s >= 0


@JUMPS
def test_plots_over_a_jump_have_every_value_in_order(harness, jump_s):
    """A plot over a clock jump has ascending times and each value once."""
    harness.live(20)
    harness.clock.forward(jump_s)
    harness.live(20)
    span = timedelta(days=3)
    series = harness.telemetry.archive.history(["uptime_s"], harness.clock() - span, harness.clock() + span, 500)
    times = list(series[0].t)
    assert times == sorted(times)
    assert len(times) == 40


def test_gaps_caused_by_retention_have_their_cause(harness):
    """A gap of packets that retention may have removed has retention as its cause."""
    harness.live(5)
    harness.live(9, received=False)
    harness.live(5)
    assert not harness.contacts.record(harness.contact).gaps[0].explained
    harness.removed_before = harness.clock() + timedelta(days=1)
    (gap,) = harness.contacts.record(harness.contact).gaps
    assert (gap.explained, gap.cause.startswith("removed by retention")) == (True, True)


def test_small_clock_corrections_are_not_jumps(harness):
    """Corrections of 0.4 s, as by a time service, are not reported as jumps."""
    for _ in range(20):
        harness.live(1)
        harness.clock.forward(0.4)
    assert harness.clocks.last_jump_s is None

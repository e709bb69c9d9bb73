"""Alarms latch, escalate, are acknowledged, shelved and closed, and survive a restart. Limit changes are recorded."""

from __future__ import annotations

import math
from datetime import timedelta

import pytest

from gss.device.session_events import DeviceEvent, DirectionCounters, LinkCounters, Telemetry
from gss.domain.errors import BadInput, Conflict, NotFound, StoreDown
from gss.domain.limits import Limits, State
from gss.instruments.dictionary.read_dictionary import load_dictionary
from gss.instruments.roles import default_roles
from gss.operations.line.dispatcher import LineEventQueue
from gss.operations.line.line_events import LineBatch
from gss.operations.line.link import LinkService
from gss.operations.telemetry import alarms
from gss.operations.telemetry.alarms import AlarmService
from gss.operations.telemetry.silence import SIGNAL_LOST_AFTER_S
from gss.operations.telemetry.telemetry import TelemetryService

FIELD = "sensor_temperature_c"  # watch −15 … 45, warning −20 … 55, critical −30 … 65, persistence 3
DICTIONARY = load_dictionary()


class AlarmHarness:
    """Telemetry and alarms on a database, without a link."""

    def __init__(self, database, bus, clock, folder) -> None:
        self.clock, self.bus = clock, bus
        self.link = LinkService(
            DICTIONARY,
            default_roles(DICTIONARY),
            database,
            bus,
            folder,
            clock,
            lambda: 0.0,
            LineEventQueue(clock, lambda: 0.0),
        )
        self.telemetry = TelemetryService(
            DICTIONARY, database, bus, clock, lambda: None, lambda: True, default_roles(DICTIONARY).quantities.status
        )
        self.alarms = AlarmService(DICTIONARY, self.telemetry, self.link, database, bus, clock)
        self.alarms.start()

    def receive(self, *values: float, **more) -> None:
        """Process one housekeeping packet per second with these temperatures."""
        for value in values:
            self.clock.forward(1)
            fields = {FIELD: value, "cycle_running": True, **more}
            batch = LineBatch((Telemetry("housekeeping", 1.0, 0, fields, fields),), self.clock(), 0.0)
            self.alarms.handle(batch.with_derived(self.telemetry.handle(batch)))

    def only(self):
        """Return the one open alarm."""
        (view,) = self.alarms.opened()
        return view

    def texts(self, kind="alarm"):
        """Return the texts of recorded events."""
        return [e.text for e in self.bus.after(0, 1000) if e.kind == kind]


@pytest.fixture
def harness(database, bus, clock, tmp_path):
    """Harness without received packets."""
    return AlarmHarness(database, bus, clock, tmp_path)


def test_an_alarm_is_raised_after_persistence_and_latches_until_normal_and_acknowledged(harness):
    """Three consecutive violations raise the alarm. When the value is normal again, the alarm remains until it is
    acknowledged."""
    harness.receive(20, 50, 50, 20, 50, 50)
    assert harness.alarms.opened() == []
    harness.receive(50)
    view = harness.only()
    assert (view.row.state, view.level, view.row.worst, view.row.value) == ("raised", State.WATCH, "watch", 50)
    assert view.row.limit_text == "above 45 (watch)"
    harness.receive(20, 20)
    assert harness.only().row.state == "raised"
    harness.receive(20)
    assert (harness.only().row.state, harness.only().level) == ("cleared", State.OK)
    closed = harness.alarms.acknowledge(view.row.id, user="ann", note="sun on the radiator")
    assert (closed.row.state, closed.row.acknowledged_by) == ("closed", "ann")
    assert "sun on the radiator" in closed.row.note
    assert harness.alarms.opened() == []
    assert next(t.split(",")[0] for t in harness.texts()) == "Sensor temperature 50.0 °C"
    with pytest.raises(Conflict, match="closed"):
        harness.alarms.acknowledge(view.row.id, user="ann")


def test_an_acknowledged_alarm_closes_when_its_value_is_normal(harness):
    """An acknowledged alarm is closed automatically when its value is normal."""
    harness.receive(50, 50, 50)
    alarm_id = harness.only().row.id
    assert harness.alarms.acknowledge(alarm_id, user="ann").row.state == "acked"
    with pytest.raises(Conflict, match="already"):
        harness.alarms.acknowledge(alarm_id, user="bob")
    harness.receive(20, 20, 20)
    row = harness.alarms.get(alarm_id).row
    assert (row.state, row.closed) == ("closed", harness.clock())


def test_a_worse_level_resets_the_acknowledgement_and_the_worst_level_is_kept(harness):
    """An acknowledged alarm is raised again when its level increases, not when it decreases. Its worst level is kept."""
    harness.receive(50, 50, 50)
    alarm_id = harness.only().row.id
    harness.alarms.acknowledge(alarm_id, user="ann")
    harness.receive(60, 60, 60)
    assert (harness.only().row.state, harness.only().row.worst, harness.only().row.acknowledged) == (
        "raised",
        "warning",
        None,
    )
    harness.alarms.acknowledge(alarm_id, user="ann")
    harness.receive(70, 70, 70)
    harness.receive(60, 60, 60)
    view = harness.only()
    assert (view.row.id, view.row.state, view.row.worst, view.level) == (alarm_id, "raised", "critical", State.WARNING)
    assert view.row.value == 70


def test_a_new_violation_before_acknowledgement_is_the_same_alarm(harness):
    """A new violation before acknowledgement raises the cleared alarm again and adds no row."""
    harness.receive(60, 60, 60, 20, 20, 20)
    alarm_id = harness.only().row.id
    harness.receive(50, 50, 50)
    view = harness.only()
    assert (view.row.id, view.row.state, view.row.worst, view.row.cleared) == (alarm_id, "raised", "warning", None)
    assert len(harness.alarms.newest(10)) == 1


def test_alarms_and_shelves_survive_a_restart(harness, database, bus, clock, tmp_path):
    """After a restart, an alarm keeps its state, level and shelving, and is closed when its value is normal."""
    harness.receive(60, 60, 60)
    alarm_id = harness.only().row.id
    harness.alarms.shelve(alarm_id, clock() + timedelta(hours=1), user="ann", note="known")
    harness.alarms.acknowledge(alarm_id, user="ann")
    restarted = AlarmHarness(database, bus, clock, tmp_path)
    view = restarted.only()
    assert (view.row.id, view.row.state, view.level, view.shelved) == (alarm_id, "acked", State.WARNING, True)
    restarted.receive(60)
    assert restarted.only().row.state == "acked"
    restarted.receive(20, 20)
    assert restarted.only().row.state == "acked"
    restarted.receive(20)
    assert restarted.alarms.opened() == []
    assert restarted.alarms.get(alarm_id).row.state == "closed"


def test_shelving_needs_a_reason_and_an_end(harness):
    """An alarm is shelved with a note for at most a day. It is shown again after this time, or when it is unshelved."""
    harness.receive(50, 50, 50)
    alarm_id = harness.only().row.id
    now = harness.clock()
    for until, note in ((now + timedelta(hours=25), "x"), (now, "x"), (now + timedelta(hours=1), "  ")):
        with pytest.raises(BadInput):
            harness.alarms.shelve(alarm_id, until, user="ann", note=note)
    assert harness.alarms.shelve(alarm_id, now + timedelta(hours=24), user="ann", note="heater test").shelved
    assert not harness.alarms.unshelve(alarm_id, user="bob").shelved
    with pytest.raises(Conflict, match="not shelved"):
        harness.alarms.unshelve(alarm_id, user="bob")
    harness.alarms.shelve(alarm_id, now + timedelta(minutes=1), user="ann", note="heater test")
    harness.clock.forward(61)
    harness.alarms.tick()
    assert not harness.only().shelved
    assert harness.only().row.shelved_until is None
    assert any("no longer shelved" in text for text in harness.texts())


def test_closing_an_alarm_needs_a_normal_or_stale_value(harness):
    """An alarm cannot be closed while a current value violates its limit. It can be closed when the value is stale."""
    harness.receive(50, 50, 50)
    alarm_id = harness.only().row.id
    with pytest.raises(Conflict, match="persists"):
        harness.alarms.clear(alarm_id, user="ann")
    harness.clock.forward(60)
    assert harness.alarms.clear(alarm_id, user="ann", note="unit switched off").row.state == "closed"
    harness.receive(50, 50)
    assert harness.alarms.opened() == []
    harness.receive(50)
    assert harness.only().row.id != alarm_id


def test_results_of_a_stopped_cycle_raise_no_alarm(harness):
    """No matched stars while the cycle runs raise an alarm, which is cleared when the cycle stops."""
    for _ in range(3):
        harness.receive(20, stars_matched=0)
    assert harness.only().row.field == "stars_matched"
    harness.receive(20, stars_matched=0, cycle_running=False)
    assert harness.only().row.state == "cleared"
    assert any("cycle is stopped" in text for text in harness.texts())


def test_a_cycle_without_an_iteration_raises_no_alarm(harness):
    """Until an iteration is complete, values of zero raise no alarm, because they are those of an idle sensor.

    The first iteration starts from the pointing before the pause and may fail; from the second on failures count.
    """
    harness.receive(20, centroids_found=0, cycle_running=False, iteration=7)
    harness.receive(20, 20, centroids_found=0, iteration=7)
    assert harness.alarms.opened() == []
    harness.receive(20, centroids_found=0, attitude_age_s=45.13, match_confidence=0.0, iteration=8)
    assert harness.alarms.opened() == []
    harness.receive(20, centroids_found=0, iteration=9)
    assert harness.only().row.field == "centroids_found"


def test_an_unmeasured_value_neither_raises_nor_clears(harness):
    """A value of NaN interrupts the count of violations and does not change the alarm."""
    harness.receive(50, 50, math.nan, 50, 50)
    assert harness.alarms.opened() == []
    harness.receive(50)
    harness.receive(20, 20, math.nan, 20, 20)
    assert harness.only().row.state == "raised"


def test_severe_device_events_raise_alarms_with_a_count(harness):
    """A latch-up raises an alarm that waits for acknowledgement, and a repetition increases its count. A harmless event
    raises no alarm."""
    event = DeviceEvent("LATCHUP", "critical", "rail fpga", 5.0)
    harness.alarms.handle(
        LineBatch(
            (
                DeviceEvent("CYCLE_STARTED", "ok", "", 4.0),
                event,
                event,
            ),
            harness.clock(),
            0.0,
        )
    )
    view = harness.only()
    assert (view.row.packet, view.row.field, view.row.state, view.row.worst) == (
        "event",
        "LATCHUP",
        "cleared",
        "critical",
    )
    assert view.text == "LATCHUP: rail fpga (2 times)"
    assert harness.alarms.acknowledge(view.row.id, user="ann").row.state == "closed"
    harness.alarms.handle(LineBatch((event,), harness.clock(), 0.0))
    assert harness.only().row.id != view.row.id


def test_a_severe_event_raises_its_alarm_after_a_failure_of_the_store(harness, monkeypatch):
    """The device reports an event once. If the store is down at that moment, the next batch raises the alarm."""
    with monkeypatch.context() as patch:

        def fails(*_):
            raise StoreDown("the database is locked")

        patch.setattr(alarms.store, "add", fails)
        harness.alarms.handle(LineBatch((DeviceEvent("LATCHUP", "critical", "", 5.0),), harness.clock(), 0.0))
    assert harness.alarms.opened() == []
    harness.alarms.handle(LineBatch((), harness.clock(), 0.0))
    assert harness.only().row.field == "LATCHUP"


def test_silence_on_an_open_line_is_loss_of_signal(harness):
    """Silence on an open line raises the alarm, and received data clear it. On a closed line there is no alarm."""
    harness.clock.forward(100)
    harness.alarms.tick()
    assert harness.alarms.opened() == []
    harness.link.line_is_open, harness.link.contact.is_open, harness.link.contact.contact_id = True, True, 1
    harness.alarms.tick()
    harness.clock.forward(SIGNAL_LOST_AFTER_S)
    harness.alarms.tick()
    assert harness.alarms.opened() == []
    harness.clock.forward(1)
    harness.alarms.tick()
    assert (harness.only().title, harness.only().row.state) == ("Loss of signal", "raised")
    harness.receive(20)
    harness.alarms.tick()
    assert harness.only().row.state == "cleared"


def test_a_sensor_that_answers_without_housekeeping_has_a_separate_alarm(harness, monkeypatch):
    """A sensor in its bootloader answers and sends no housekeeping. The alarm states this and the remedy."""
    harness.link.line_is_open, harness.link.contact.is_open, harness.link.contact.contact_id = True, True, 1
    harness.alarms.tick()
    monkeypatch.setattr(type(harness.link), "counters", LinkCounters(DirectionCounters(), DirectionCounters(), 0.0))
    for _ in range(int(SIGNAL_LOST_AFTER_S) + 1):
        assert harness.alarms.opened() == []
        harness.clock.forward(1)
        harness.alarms.tick()
    assert harness.only().text == "No housekeeping for 5 s, although the sensor answers"
    assert harness.only().action.startswith("Boot the sensor")
    harness.receive(20)
    harness.alarms.tick()
    assert harness.only().row.state == "cleared"


def test_a_limit_set_changes_the_violations_and_is_stored(harness, database, bus, clock, tmp_path):
    """A value of 50 °C is a watch in the nominal limit set and normal in that for commissioning. The selection is recorded
    and survives a restart."""
    harness.receive(50, 50, 50)
    assert harness.only().row.limit_set == "nominal"
    harness.telemetry.limits.choose("commissioning", user="ann", note="bench")
    harness.receive(50, 50, 50)
    assert harness.only().row.state == "cleared"
    assert "ann activated the limit set commissioning; was nominal: bench" in harness.texts("limits")
    assert AlarmHarness(database, bus, clock, tmp_path).telemetry.limits.chosen == "commissioning"
    with pytest.raises(NotFound, match="limit set"):
        harness.telemetry.limits.choose("party", user="ann")


def test_custom_limits_apply_until_they_are_reset_and_are_recorded_with_the_user(
    harness, database, bus, clock, tmp_path
):
    """An operator's limits override the set until they are reset, and are recorded with the user. Contradictory values,
    text fields and unknown fields are rejected."""
    book, key = harness.telemetry.limits, f"housekeeping.{FIELD}"
    custom = Limits((0, 30), (-5, 35), (-10, 40))
    book.override(key, custom, 1, user="ann", note="thermal test")
    harness.receive(31)
    assert (harness.only().row.worst, harness.only().row.limit_text) == ("watch", "above 30 (watch)")
    after = AlarmHarness(database, bus, clock, tmp_path).telemetry.limits.rule("housekeeping", book.find(key)[1])
    assert (after.limits, after.persistence, after.origin, after.changed_by) == (custom, 1, "operator", "ann")
    (text,) = harness.texts("limits")
    assert "ann changed the limits of housekeeping.sensor_temperature_c from watch -15 … 45" in text
    assert text.endswith("1 sample: thermal test")
    assert book.restore(key, user="bob").origin == "dictionary"
    for unknown_field in (f"housekeeping.{FIELD}x", "warp.x", FIELD):
        with pytest.raises(NotFound):
            book.override(unknown_field, custom, 1, user="ann")
    with pytest.raises(BadInput, match="numbers and yes"):
        book.override("housekeeping.mode", custom, 1, user="ann")
    with pytest.raises(BadInput, match="persistence"):
        book.override(key, custom, 0, user="ann")
    with pytest.raises(BadInput, match="limits are empty"):
        book.override(key, Limits((2, 1)), 1, user="ann")


def test_an_unacknowledged_alarm_keeps_its_place_after_its_value_is_back(harness):
    """A cleared critical alarm is listed before an active watch until it is acknowledged."""
    harness.receive(*[70] * 4, *[20] * 3, stars_matched=10)
    assert harness.only().row.state == "cleared"
    harness.receive(*[20] * 4, stars_matched=3)
    listed = harness.alarms.opened()
    assert [(v.row.field, v.row.state) for v in listed] == [(FIELD, "cleared"), ("stars_matched", "raised")]
    harness.receive(*[70] * 4, stars_matched=3)
    harness.alarms.acknowledge(listed[0].row.id, user="ann")
    harness.receive(*[50] * 4, stars_matched=3)
    assert [(v.row.field, v.level) for v in harness.alarms.opened()] == [
        ("stars_matched", State.WATCH),
        (FIELD, State.WATCH),
    ], "an acknowledged alarm is sorted by its current level"


def test_an_alarm_has_the_action_of_the_dictionary(harness):
    """The action of an alarm is that of the dictionary's field or event."""
    harness.receive(*[70] * 4)
    field = next(f for f in DICTIONARY.packet("housekeeping").values if f.name == FIELD)
    assert harness.only().action == field.action != ""
    harness.alarms.handle(LineBatch((DeviceEvent("BANK_CORRUPT", "warning", "bank A", 1.0),), harness.clock(), 0.0))
    event = next(v for v in harness.alarms.opened() if v.row.field == "BANK_CORRUPT")
    assert event.action.startswith("Do not activate")

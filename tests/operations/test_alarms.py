"""Alarms latch, escalate, are seen, shelved and closed, and survive a restart; limits are chosen and changed on record."""

from __future__ import annotations

import math
from datetime import timedelta

import pytest

from gss.device.dictionary_file import load_dictionary
from gss.device.session_events import DeviceEvent, Telemetry
from gss.domain.errors import BadInput, Conflict, NotFound
from gss.domain.limits import Limits, State
from gss.operations.line.line_events import LineBatch, LineEventQueue
from gss.operations.line.link import LinkService
from gss.operations.telemetry.alarms import SIGNAL_LOST_AFTER_S, AlarmService
from gss.operations.telemetry.telemetry import TelemetryService

FIELD = "sensor_temperature_c"  # watch −15 … 45, warning −20 … 55, critical −30 … 65, persistence 3
DICTIONARY = load_dictionary()


class Room:
    """Telemetry and alarms on a database, without a line."""

    def __init__(self, database, bus, clock, folder) -> None:
        self.clock, self.bus = clock, bus
        self.link = LinkService(
            DICTIONARY, database, bus, folder, clock, lambda: 0.0, LineEventQueue(clock, lambda: 0.0)
        )
        self.telemetry = TelemetryService(DICTIONARY, database, bus, clock, lambda: None, lambda: True)
        self.alarms = AlarmService(DICTIONARY, self.telemetry, self.link, database, bus, clock)
        self.alarms.start()

    def hear(self, *values: float, **more) -> None:
        """One housekeeping packet a second with these temperatures."""
        for value in values:
            self.clock.forward(1)
            fields = {FIELD: value, "cycle_running": True, **more}
            batch = LineBatch((Telemetry("housekeeping", 1.0, 0, fields, fields),), self.clock(), 0.0)
            self.alarms.handle(batch.with_derived(self.telemetry.handle(batch)))

    def only(self):
        """The one open alarm."""
        (view,) = self.alarms.opened()
        return view

    def texts(self, kind="alarm"):
        """What was recorded."""
        return [e.text for e in self.bus.after(0, 1000) if e.kind == kind]


@pytest.fixture
def room(database, bus, clock, tmp_path):
    """A fresh room."""
    return Room(database, bus, clock, tmp_path)


def test_an_alarm_is_raised_when_the_value_insists_and_stays_until_it_is_back_and_seen(room):
    """Two samples out are nothing, three raise; back in limits it waits to be seen; seen, it closes."""
    room.hear(20, 50, 50, 20, 50, 50)
    assert room.alarms.opened() == []
    room.hear(50)
    view = room.only()
    assert (view.row.state, view.level, view.row.worst, view.row.value) == ("raised", State.WATCH, "watch", 50)
    assert view.row.limit_text == "above 45 (watch)"
    room.hear(20, 20)
    assert room.only().row.state == "raised"
    room.hear(20)
    assert (room.only().row.state, room.only().level) == ("cleared", State.OK)
    closed = room.alarms.acknowledge(view.row.id, user="ann", note="sun on the radiator")
    assert (closed.row.state, closed.row.acknowledged_by) == ("closed", "ann")
    assert "sun on the radiator" in closed.row.note
    assert room.alarms.opened() == []
    assert next(t.split(",")[0] for t in room.texts()) == "Sensor temperature 50.0 °C"
    with pytest.raises(Conflict, match="closed"):
        room.alarms.acknowledge(view.row.id, user="ann")


def test_a_seen_alarm_closes_when_its_value_comes_back(room):
    """acked, then closed, without anybody's help."""
    room.hear(50, 50, 50)
    alarm_id = room.only().row.id
    assert room.alarms.acknowledge(alarm_id, user="ann").row.state == "acked"
    with pytest.raises(Conflict, match="already"):
        room.alarms.acknowledge(alarm_id, user="bob")
    room.hear(20, 20, 20)
    row = room.alarms.get(alarm_id).row
    assert (row.state, row.closed) == ("closed", room.clock())


def test_a_worse_level_takes_the_acknowledgement_back_and_the_worst_is_kept(room):
    """watch, seen, warning, critical, warning: raised again at each step up only."""
    room.hear(50, 50, 50)
    alarm_id = room.only().row.id
    room.alarms.acknowledge(alarm_id, user="ann")
    room.hear(60, 60, 60)
    assert (room.only().row.state, room.only().row.worst, room.only().row.acknowledged) == ("raised", "warning", None)
    room.alarms.acknowledge(alarm_id, user="ann")
    room.hear(70, 70, 70)
    room.hear(60, 60, 60)
    view = room.only()
    assert (view.row.id, view.row.state, view.row.worst, view.level) == (alarm_id, "raised", "critical", State.WARNING)
    assert view.row.value == 70


def test_out_again_before_it_was_seen_is_the_same_alarm(room):
    """cleared goes back to raised; there is no second row."""
    room.hear(60, 60, 60, 20, 20, 20)
    alarm_id = room.only().row.id
    room.hear(50, 50, 50)
    view = room.only()
    assert (view.row.id, view.row.state, view.row.worst, view.row.cleared) == (alarm_id, "raised", "warning", None)
    assert len(room.alarms.newest(10)) == 1


def test_alarms_and_shelves_survive_a_restart(room, database, bus, clock, tmp_path):
    """A new server knows the alarm, goes on counting it as out, and closes it as the old one would have."""
    room.hear(60, 60, 60)
    alarm_id = room.only().row.id
    room.alarms.shelve(alarm_id, clock() + timedelta(hours=1), user="ann", note="known")
    room.alarms.acknowledge(alarm_id, user="ann")
    again = Room(database, bus, clock, tmp_path)
    view = again.only()
    assert (view.row.id, view.row.state, view.level, view.shelved) == (alarm_id, "acked", State.WARNING, True)
    again.hear(60)
    assert again.only().row.state == "acked"
    again.hear(20, 20)
    assert again.only().row.state == "acked"
    again.hear(20)
    assert again.alarms.opened() == []
    assert again.alarms.get(alarm_id).row.state == "closed"


def test_a_shelf_has_a_reason_and_an_end(room):
    """At most a day, with a note; when the time is over the alarm is shown again, and it can be taken off before."""
    room.hear(50, 50, 50)
    alarm_id = room.only().row.id
    now = room.clock()
    for until, note in ((now + timedelta(hours=25), "x"), (now, "x"), (now + timedelta(hours=1), "  ")):
        with pytest.raises(BadInput):
            room.alarms.shelve(alarm_id, until, user="ann", note=note)
    assert room.alarms.shelve(alarm_id, now + timedelta(hours=24), user="ann", note="heater test").shelved
    assert not room.alarms.unshelve(alarm_id, user="bob").shelved
    with pytest.raises(Conflict, match="not shelved"):
        room.alarms.unshelve(alarm_id, user="bob")
    room.alarms.shelve(alarm_id, now + timedelta(minutes=1), user="ann", note="heater test")
    room.clock.forward(61)
    room.alarms.tick()
    assert not room.only().shelved
    assert room.only().row.shelved_until is None
    assert any("back from the shelf" in text for text in room.texts())


def test_closing_by_hand_needs_the_cause_to_be_gone_or_out_of_sight(room):
    """While the value is out and fresh it is refused; once nothing comes any more it is not."""
    room.hear(50, 50, 50)
    alarm_id = room.only().row.id
    with pytest.raises(Conflict, match="still there"):
        room.alarms.clear(alarm_id, user="ann")
    room.clock.forward(60)
    assert room.alarms.clear(alarm_id, user="ann", note="unit switched off").row.state == "closed"
    room.hear(50, 50)
    assert room.alarms.opened() == []
    room.hear(50)
    assert room.only().row.id != alarm_id


def test_results_of_a_stopped_cycle_are_not_held_against_the_sensor(room):
    """No stars with the cycle running is an alarm; when the cycle stops it waits only to be seen."""
    for _ in range(3):
        room.hear(20, stars_matched=0)
    assert room.only().row.field == "stars_matched"
    room.hear(20, stars_matched=0, cycle_running=False)
    assert room.only().row.state == "cleared"
    assert any("cycle is stopped" in text for text in room.texts())


def test_a_cycle_that_has_just_started_is_not_blamed_for_having_found_nothing(room):
    """Running, but no iteration yet: the zeros are those of a sensor at rest. The first one looks where the sensor pointed before
    the rest, and may miss; after the second they count."""
    room.hear(20, centroids_found=0, cycle_running=False, iteration=7)
    room.hear(20, 20, centroids_found=0, iteration=7)
    assert room.alarms.opened() == []
    room.hear(20, centroids_found=0, attitude_age_s=45.13, match_confidence=0.0, iteration=8)
    assert room.alarms.opened() == []
    room.hear(20, centroids_found=0, iteration=9)
    assert room.only().row.field == "centroids_found"


def test_an_unmeasured_value_neither_raises_nor_clears(room):
    """Not-a-number breaks the run of samples and leaves the alarm as it is."""
    room.hear(50, 50, math.nan, 50, 50)
    assert room.alarms.opened() == []
    room.hear(50)
    room.hear(20, 20, math.nan, 20, 20)
    assert room.only().row.state == "raised"


def test_severe_device_events_are_alarms_that_count(room):
    """A latch-up waits to be seen; the same again counts up; a harmless event is none."""
    event = DeviceEvent("LATCHUP", "critical", "rail fpga", 5.0)
    room.alarms.handle(
        LineBatch(
            (
                DeviceEvent("CYCLE_STARTED", "ok", "", 4.0),
                event,
                event,
            ),
            room.clock(),
            0.0,
        )
    )
    view = room.only()
    assert (view.row.packet, view.row.field, view.row.state, view.row.worst) == (
        "event",
        "LATCHUP",
        "cleared",
        "critical",
    )
    assert view.text == "LATCHUP: rail fpga (2 times)"
    assert room.alarms.acknowledge(view.row.id, user="ann").row.state == "closed"
    room.alarms.handle(LineBatch((event,), room.clock(), 0.0))
    assert room.only().row.id != view.row.id


def test_silence_on_an_open_line_is_loss_of_signal(room):
    """Nothing while the line is closed; open and silent it is raised; heard again or closed it is over."""
    room.clock.forward(100)
    room.alarms.tick()
    assert room.alarms.opened() == []
    room.link.line_is_open, room.link.contact.is_open, room.link.contact.contact_id = True, True, 1
    room.alarms.tick()
    room.clock.forward(SIGNAL_LOST_AFTER_S)
    room.alarms.tick()
    assert room.alarms.opened() == []
    room.clock.forward(1)
    room.alarms.tick()
    assert (room.only().title, room.only().row.state) == ("Loss of signal", "raised")
    room.hear(20)
    room.alarms.tick()
    assert room.only().row.state == "cleared"


def test_a_limit_set_changes_what_is_out_and_is_remembered(room, database, bus, clock, tmp_path):
    """50 °C is a watch in service and nothing while commissioning; the choice outlives the server."""
    room.hear(50, 50, 50)
    assert room.only().row.limit_set == "nominal"
    room.telemetry.limits.choose("commissioning", user="ann", note="bench")
    room.hear(50, 50, 50)
    assert room.only().row.state == "cleared"
    assert "ann put the limit set commissioning in force, before it was nominal: bench" in room.texts("limits")
    assert Room(database, bus, clock, tmp_path).telemetry.limits.chosen == "commissioning"
    with pytest.raises(NotFound, match="limit set"):
        room.telemetry.limits.choose("party", user="ann")


def test_own_limits_hold_until_they_are_taken_back_and_who_did_it_is_on_record(room, database, bus, clock, tmp_path):
    """An operator's limits win over the set; contradictions, texts and unknown fields are refused."""
    book, key = room.telemetry.limits, f"housekeeping.{FIELD}"
    own = Limits((0, 30), (-5, 35), (-10, 40))
    book.override(key, own, 1, user="ann", note="thermal test")
    room.hear(31)
    assert (room.only().row.worst, room.only().row.limit_text) == ("watch", "above 30 (watch)")
    after = Room(database, bus, clock, tmp_path).telemetry.limits.rule("housekeeping", book.find(key)[1])
    assert (after.limits, after.persistence, after.origin, after.changed_by) == (own, 1, "operator", "ann")
    (text,) = room.texts("limits")
    assert "ann changed the limits of housekeeping.sensor_temperature_c from watch -15 … 45" in text
    assert text.endswith("1 sample: thermal test")
    assert book.restore(key, user="bob").origin == "dictionary"
    for bad in (f"housekeeping.{FIELD}x", "warp.x", FIELD):
        with pytest.raises(NotFound):
            book.override(bad, own, 1, user="ann")
    with pytest.raises(BadInput, match="numbers and yes"):
        book.override("housekeeping.mode", own, 1, user="ann")
    with pytest.raises(BadInput, match="persistence"):
        book.override(key, own, 0, user="ann")
    with pytest.raises(BadInput, match="hold nothing"):
        book.override(key, Limits((2, 1)), 1, user="ann")


def test_what_is_outside_now_comes_before_what_is_back(room):
    """A critical alarm whose value is back, not yet seen, stands behind a watch whose value is still out."""
    room.hear(*[70] * 4, *[20] * 3, stars_matched=10)
    assert room.only().row.state == "cleared"
    room.hear(*[20] * 4, stars_matched=3)
    assert [(v.row.field, v.row.state) for v in room.alarms.opened()] == [
        ("stars_matched", "raised"),
        (FIELD, "cleared"),
    ]

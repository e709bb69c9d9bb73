"""Scheduled commands: at a UTC time, listed as text, cancelled, and rejected with reasons."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import pytest

from gss.device.session_events import Telemetry
from gss.domain.errors import BadInput, Conflict, NotFound

pytestmark = pytest.mark.timeout(120)
START = datetime(2026, 12, 1, 18, 0, tzinfo=UTC)


@pytest.fixture
def console(make_console, sensor_in_memory):
    """Console whose clock follows the sensor's time, with correlated clocks and an empty schedule from the device."""
    sensor = sensor_in_memory()
    console = make_console(sensor, now=lambda: START + timedelta(seconds=sensor.now_s), schedule=True)
    console.schedule._request_list()
    console.wait(lambda: console.schedule.clock() is not None and console.schedule.state().listed_at is not None)
    return console


def in_seconds(console, seconds: float) -> datetime:
    return START + timedelta(seconds=console.sensor.now_s + seconds)


def put(console, name: str, seconds: float, *, confirm: str = "", user: str = "ann", **arguments):
    """Schedule a command and wait for the device's report and its list."""
    row = console.schedule.send(
        name, arguments, at=in_seconds(console, seconds), at_device_s=None, confirm=confirm, user=user
    )
    row = console.end(row)
    if row.result == "completed":
        console.wait(lambda: row.values["schedule_id"] in by_id(console))
    return row


def by_id(console):
    return {entry.schedule_id: entry for entry in console.schedule.state().entries}


def problems(console, name: str, **when):
    return console.schedule.plan(name, {}, at=when.get("at"), at_device_s=when.get("at_device_s")).problems


def test_a_command_runs_on_board_at_its_utc_time(console):
    """A scheduled command is listed with name, arguments and time, runs at this time, and is then listed as done."""
    at = in_seconds(console, 20)
    row = put(console, "SET_EXPOSURE", 20, exposure_ms=321)
    assert (row.name, row.source, row.result) == ("SCHEDULE", "schedule", "completed")
    entry = by_id(console)[row.values["schedule_id"]]
    assert (entry.command, dict(entry.arguments), entry.state) == ("SET_EXPOSURE", {"exposure_ms": 321}, "waiting")
    assert abs((entry.at - at).total_seconds()) < entry.uncertainty_s + 0.2
    assert 0 < entry.uncertainty_s < 1
    console.wait(lambda: console.link.session.housekeeping["exposure_ms"] == 321)
    assert 15 < (console.link._now() - at).total_seconds() + 20 < 30
    console.wait(lambda: by_id(console)[entry.schedule_id].state == "done")


def test_the_list_is_the_devices_not_the_grounds(console):
    """Entries that the device no longer lists are removed. An entry with an unknown command is listed with its bytes."""
    row = put(console, "GET_STATUS", 500)
    number = row.values["schedule_id"]
    console.sensor.memory.record.schedule.clear()
    console.end(console.schedule.refresh(user="ann"))
    console.wait(lambda: number not in by_id(console))
    assert console.schedule.state().complete
    put(console, "SET_EXPOSURE", 500, exposure_ms=5)
    record = console.sensor.memory.record
    from dataclasses import replace

    record.schedule[0] = replace(record.schedule[0], command_code=199, payload="beef")
    console.end(console.schedule.refresh(user="ann"))
    console.wait(lambda: [e.command for e in console.schedule.state().entries] == [None])
    assert console.schedule.state().entries[0].payload == b"\xbe\xef"


def test_one_or_all_are_cancelled(console):
    """One entry or all can be cancelled. Cancelling an entry that is not waiting or unknown is rejected."""
    one, two, three = (put(console, "GET_STATUS", 500 + k).values["schedule_id"] for k in range(3))
    console.end(console.schedule.cancel(two, user="ann"))
    console.wait(lambda: [by_id(console)[k].state for k in (one, two, three)] == ["waiting", "cancelled", "waiting"])
    with pytest.raises(Conflict, match="only waiting") as caught:
        console.schedule.cancel(two, user="ann")
    assert caught.value.got == "cancelled"
    with pytest.raises(NotFound, match="no scheduled command"):
        console.schedule.cancel(9999, user="ann")
    console.end(console.schedule.cancel_all(user="ann"))
    console.wait(lambda: {by_id(console)[k].state for k in (one, three)} == {"cancelled"})


@pytest.mark.parametrize("name", ["ABORT", "HELLO", "SCHEDULE", "LIST_SCHEDULE", "CANCEL", "SIM_INJECT"])
def test_commands_that_cannot_be_scheduled_are_rejected(console, name):
    """Commands that cannot be scheduled are rejected with the reason, and nothing is sent."""
    written = len(console.sensor.written)
    with pytest.raises(BadInput, match=f"{name} cannot be scheduled"):
        console.schedule.send(name, {}, at=in_seconds(console, 60), at_device_s=None, confirm=name, user="ann")
    assert len(console.sensor.written) == written


def test_a_time_in_the_past_is_rejected(console):
    """A past time is rejected in UTC and in device time. Exactly one of the two must be given."""
    now_s = console.schedule.clock().device_of(console.link._now().timestamp())
    assert "in the past" in problems(console, "GET_STATUS", at=in_seconds(console, -60))[0]
    assert "in the past" in problems(console, "GET_STATUS", at_device_s=now_s - 60)[0]
    assert problems(console, "GET_STATUS", at_device_s=now_s + 60) == ()
    assert "either a UTC time or a device time" in problems(console, "GET_STATUS")[0]
    both = problems(console, "GET_STATUS", at=in_seconds(console, 60), at_device_s=now_s + 60)
    assert "either a UTC time or a device time" in both[0]


def test_warnings_do_not_prevent_scheduling(console):
    """A reset, a time in the near future, conditions checked on board and an uncertain time give warnings only."""

    def warned(name: str, seconds: float) -> str:
        plan = console.schedule.plan(name, {}, at=in_seconds(console, seconds), at_device_s=None)
        assert plan.problems == ()
        return " | ".join(plan.warnings)

    assert "restarts unattended" in warned("RESET", 60)
    assert "may arrive too late" in warned("GET_STATUS", 2)
    assert "Cycle is stopped" in warned("TAKE_IMAGE", 60)
    assert "CONFIRM_BANK must follow" in warned("ACTIVATE_BANK", 60)
    assert "uncertain by ±" in warned("GET_STATUS", 86_400)


def test_the_inner_command_is_checked_and_confirmed_now(console):
    """Arguments and hazard of the inner command are checked, and confirmed, when it is scheduled."""
    with pytest.raises(BadInput, match="1 – 2000"):
        put(console, "SET_EXPOSURE", 60, exposure_ms=2001)
    with pytest.raises(BadInput, match="ERASE_BANK is critical"):
        put(console, "ERASE_BANK", 60, bank="C", confirm="SCHEDULE")
    plan = console.schedule.plan("ERASE_BANK", {"bank": "C"}, at=in_seconds(console, 60), at_device_s=None)
    assert (plan.risk.hazard, plan.risk.name) == ("critical", "ERASE_BANK")
    row = put(console, "ERASE_BANK", 60, bank="C", confirm="ERASE_BANK")
    assert by_id(console)[row.values["schedule_id"]].hazard == "critical"


def test_a_full_schedule_is_reported_by_the_device(console):
    """The 17th entry fails with the device's reason, and existing entries are kept."""
    rows = [put(console, "GET_STATUS", 1000 + k) for k in range(16)]
    assert {row.result for row in rows} == {"completed"}
    row = put(console, "GET_STATUS", 2000)
    assert row.result == "failed"
    assert row.detail.startswith("schedule_full")
    assert sum(entry.state == "waiting" for entry in console.schedule.state().entries) == 16


def test_scheduling_needs_command_authority(console):
    """A user without command authority can neither schedule nor cancel."""
    put(console, "GET_STATUS", 500)
    with pytest.raises(Conflict, match="held by ann"):
        put(console, "GET_STATUS", 500, user="bob")
    with pytest.raises(Conflict, match="held by ann"):
        console.schedule.cancel_all(user="bob")
    assert not any("cancels all" in event.text for event in console.bus.after(0, 1000))


def test_without_correlated_clocks_only_device_time_is_accepted(console):
    """While the clocks are not correlated, a UTC time is rejected and a device time accepted. Packets without a device time
    do not correlate them."""
    put(console, "GET_STATUS", 500)
    console.schedule_subscribed = False
    console.schedule._clock.restart()
    for k in range(100):
        console.schedule._packet(Telemetry("housekeeping", 0.0, 0, {}, {}), in_seconds(console, 0.01 * k))
    plan = console.schedule.plan("GET_STATUS", {}, at=in_seconds(console, 60), at_device_s=None)
    assert "device clock offset unknown" in plan.problems[0]
    plan = console.schedule.plan("GET_STATUS", {}, at=None, at_device_s=60.0)
    assert (plan.problems, plan.at, plan.uncertainty_s) == ((), None, None)
    assert "offset unknown" in plan.warnings[0]
    assert [(e.at, e.uncertainty_s) for e in console.schedule.state().entries] == [(None, None)]

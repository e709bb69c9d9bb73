"""Commands for later: at a moment of UTC, listed back in words, cancelled, and refused with reasons."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta

import pytest

from gss.domain.errors import BadInput, Conflict, NotFound

pytestmark = pytest.mark.timeout(120)
START = datetime(2026, 12, 1, 18, 0, tzinfo=UTC)


@pytest.fixture
def desk(make_desk, sensor_in_memory):
    """A desk whose wall clock goes as the sensor's time does, with correlated clocks and an empty table told."""
    sensor = sensor_in_memory()
    desk = make_desk(sensor, now=lambda: START + timedelta(seconds=sensor.now_s), schedule=True)
    desk.schedule._ask()
    desk.wait(lambda: desk.schedule.clock() is not None and desk.schedule.state().told is not None)
    return desk


def in_seconds(desk, seconds: float) -> datetime:
    return START + timedelta(seconds=desk.sensor.now_s + seconds)


def put(desk, name: str, seconds: float, *, confirm: str = "", user: str = "ann", **arguments):
    """Schedule it and wait for the device's word and its list."""
    row = desk.schedule.send(
        name, arguments, at=in_seconds(desk, seconds), at_device_s=None, confirm=confirm, user=user
    )
    row = desk.end(row)
    if row.result == "completed":
        desk.wait(lambda: row.values["schedule_id"] in by_id(desk))
    return row


def by_id(desk):
    return {entry.schedule_id: entry for entry in desk.schedule.state().entries}


def problems(desk, name: str, **when):
    return desk.schedule.plan(name, {}, at=when.get("at"), at_device_s=when.get("at_device_s")).problems


def test_a_command_runs_on_board_at_its_moment_of_utc(desk):
    """Listed with name, arguments and moment; it runs when the device's clock says so; the list then says done."""
    at = in_seconds(desk, 20)
    row = put(desk, "SET_EXPOSURE", 20, exposure_ms=321)
    assert (row.name, row.source, row.result) == ("SCHEDULE", "schedule", "completed")
    entry = by_id(desk)[row.values["schedule_id"]]
    assert (entry.command, dict(entry.arguments), entry.state) == ("SET_EXPOSURE", {"exposure_ms": 321}, "waiting")
    assert abs((entry.at - at).total_seconds()) < entry.uncertainty_s + 0.2
    assert 0 < entry.uncertainty_s < 1
    desk.wait(lambda: desk.link.session.housekeeping["exposure_ms"] == 321)
    assert 15 < (desk.link._now() - at).total_seconds() + 20 < 30
    desk.wait(lambda: by_id(desk)[entry.schedule_id].state == "done")


def test_the_list_is_the_devices_and_not_ours(desk):
    """What the device no longer names is gone, whatever the ground remembers; bytes of another dictionary stay bytes."""
    row = put(desk, "GET_STATUS", 500)
    number = row.values["schedule_id"]
    desk.sensor.memory.record.schedule.clear()
    desk.end(desk.schedule.refresh(user="ann"))
    desk.wait(lambda: number not in by_id(desk))
    assert desk.schedule.state().complete
    put(desk, "SET_EXPOSURE", 500, exposure_ms=5)
    record = desk.sensor.memory.record
    from dataclasses import replace

    record.schedule[0] = replace(record.schedule[0], command_code=199, payload="beef")
    desk.end(desk.schedule.refresh(user="ann"))
    desk.wait(lambda: [e.command for e in desk.schedule.state().entries] == [None])
    assert desk.schedule.state().entries[0].payload == b"\xbe\xef"


def test_one_or_all_are_cancelled(desk):
    """By number, and everything at once; what does not wait is refused before anything is sent."""
    one, two, three = (put(desk, "GET_STATUS", 500 + k).values["schedule_id"] for k in range(3))
    desk.end(desk.schedule.cancel(two, user="ann"))
    desk.wait(lambda: [by_id(desk)[k].state for k in (one, two, three)] == ["waiting", "cancelled", "waiting"])
    with pytest.raises(Conflict, match="only what waits") as caught:
        desk.schedule.cancel(two, user="ann")
    assert caught.value.got == "cancelled"
    with pytest.raises(NotFound, match="nothing is scheduled"):
        desk.schedule.cancel(9999, user="ann")
    desk.end(desk.schedule.cancel_all(user="ann"))
    desk.wait(lambda: {by_id(desk)[k].state for k in (one, three)} == {"cancelled"})


@pytest.mark.parametrize("name", ["ABORT", "HELLO", "SCHEDULE", "LIST_SCHEDULE", "CANCEL", "SIM_INJECT"])
def test_what_makes_no_sense_later_is_refused(desk, name):
    """With the reason, and nothing is sent."""
    written = len(desk.sensor.written)
    with pytest.raises(BadInput, match=f"{name} cannot be scheduled"):
        desk.schedule.send(name, {}, at=in_seconds(desk, 60), at_device_s=None, confirm=name, user="ann")
    assert len(desk.sensor.written) == written


def test_a_moment_that_is_past_is_refused(desk):
    """In UTC and in device time; the device's clock is told."""
    now_s = desk.schedule.clock().device_of(desk.link._now().timestamp())
    assert "the time is past" in problems(desk, "GET_STATUS", at=in_seconds(desk, -60))[0]
    assert "the time is past" in problems(desk, "GET_STATUS", at_device_s=now_s - 60)[0]
    assert problems(desk, "GET_STATUS", at_device_s=now_s + 60) == ()
    assert "either in UTC or in device time" in problems(desk, "GET_STATUS")[0]
    both = problems(desk, "GET_STATUS", at=in_seconds(desk, 60), at_device_s=now_s + 60)
    assert "either in UTC or in device time" in both[0]


def test_warnings_do_not_forbid(desk):
    """RESET, a close moment, conditions that are checked on board, a moment that is not well known."""

    def warned(name: str, seconds: float) -> str:
        plan = desk.schedule.plan(name, {}, at=in_seconds(desk, seconds), at_device_s=None)
        assert plan.problems == ()
        return " | ".join(plan.warnings)

    assert "restarts unattended" in warned("RESET", 60)
    assert "may arrive after its time" in warned("GET_STATUS", 2)
    assert "Cycle is stopped" in warned("TAKE_IMAGE", 60)
    assert "CONFIRM_BANK must follow" in warned("ACTIVATE_BANK", 60)
    assert "only known to ±" in warned("GET_STATUS", 86_400)


def test_the_inner_command_is_checked_and_confirmed_now(desk):
    """Its arguments and its hazard do not wait for their time."""
    with pytest.raises(BadInput, match="1 – 2000"):
        put(desk, "SET_EXPOSURE", 60, exposure_ms=2001)
    with pytest.raises(BadInput, match="ERASE_BANK is critical"):
        put(desk, "ERASE_BANK", 60, bank="C", confirm="SCHEDULE")
    plan = desk.schedule.plan("ERASE_BANK", {"bank": "C"}, at=in_seconds(desk, 60), at_device_s=None)
    assert (plan.risk.hazard, plan.risk.name) == ("critical", "ERASE_BANK")
    row = put(desk, "ERASE_BANK", 60, bank="C", confirm="ERASE_BANK")
    assert by_id(desk)[row.values["schedule_id"]].hazard == "critical"


def test_a_full_table_is_told_by_the_device(desk):
    """The refusal comes back with its reason; what was there stays."""
    rows = [put(desk, "GET_STATUS", 1000 + k) for k in range(16)]
    assert {row.result for row in rows} == {"completed"}
    row = put(desk, "GET_STATUS", 2000)
    assert row.result == "failed"
    assert row.detail.startswith("schedule_full")
    assert sum(entry.state == "waiting" for entry in desk.schedule.state().entries) == 16


def test_scheduling_is_commanding(desk):
    """It needs command authority, and so does taking back."""
    put(desk, "GET_STATUS", 500)
    with pytest.raises(Conflict, match="held by ann"):
        put(desk, "GET_STATUS", 500, user="bob")
    with pytest.raises(Conflict, match="held by ann"):
        desk.schedule.cancel_all(user="bob")


def test_without_correlated_clocks_only_device_time_is_taken(desk):
    """No claim about UTC before enough packets have come."""
    put(desk, "GET_STATUS", 500)
    desk.schedule_hears = False
    desk.schedule._clock.restart()
    plan = desk.schedule.plan("GET_STATUS", {}, at=in_seconds(desk, 60), at_device_s=None)
    assert "not correlated with UTC yet" in plan.problems[0]
    plan = desk.schedule.plan("GET_STATUS", {}, at=None, at_device_s=60.0)
    assert (plan.problems, plan.at, plan.uncertainty_s) == ((), None, None)
    assert "not known" in plan.warnings[0]
    assert [(e.at, e.uncertainty_s) for e in desk.schedule.state().entries] == [(None, None)]

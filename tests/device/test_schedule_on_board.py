"""Scheduled commands survive a reset, are executed with all checks, and are reported."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING

import pytest

from gss.device.protocol.codec import encode
from gss.device.session_events import CommandUpdate, Stage, Telemetry
from gss.instruments.dictionary.checked_values import check_arguments
from gss.instruments.package_files import UnitTiming

if TYPE_CHECKING:
    from conftest import Bench


def schedule(bench: Bench, seconds: float, name: str, **arguments: float | str | bool) -> CommandUpdate:
    """Schedule a command by name, ``seconds`` after the current device time."""
    command = bench.dictionary.command(name)
    payload = encode(command.arguments, check_arguments(command, arguments))
    at_s = bench.device.time_s + seconds
    return bench.do("SCHEDULE", at_s=at_s, command_code=command.code, length=len(payload), payload=payload.hex())


def entries(bench: Bench) -> dict[int, Telemetry]:
    """Return the last report on each entry."""
    return {int(t.values["schedule_id"]): t for t in bench.telemetry("schedule_entry")}


def test_a_command_runs_at_its_time(bench: Bench) -> None:
    """A scheduled command runs once, not before its time. Its reports have the request id of SCHEDULE. Housekeeping has
    the number of waiting entries."""
    done = schedule(bench, 3.0, "TAKE_IMAGE", slot=2)
    number = int(done.values["schedule_id"])
    status = bench.status()
    assert (status["scheduled"], number) == (1, 1)
    due_s = float(status["next_scheduled_s"])
    bench.until(lambda: bench.device.time_s > due_s - 0.1)
    assert bench.do("LIST_FRAMES").values == {"count": 0}
    bench.run(3.0)
    (run_event,) = bench.device_events("SCHEDULE_RUN")
    assert "TAKE_IMAGE" in run_event.text
    (info,) = bench.telemetry("frame_info")
    assert (info.request_id, run_event.request_id) == (done.request_id, done.request_id)
    assert info.values["slot"] == 2
    assert entries(bench)[number].values["state"] == "done"
    assert bench.status()["scheduled"] == 0
    stages = [s.stage for s in bench.stages(done.request_id)]
    assert stages.count(Stage.COMPLETED) == 1


def test_preconditions_are_checked_at_execution_time(bench: Bench) -> None:
    """A scheduled TAKE_IMAGE that is due while the cycle runs fails with the reason, and the cycle continues."""
    schedule(bench, 2.0, "TAKE_IMAGE")
    bench.do("START_CYCLE")
    bench.run(3.0)
    (failure,) = bench.device_events("SCHEDULE_FAILED")
    assert "wrong_state" in failure.text
    assert entries(bench)[1].values["reason"] == "wrong_state"
    assert bench.status()["cycle_running"] is True


def test_the_schedule_survives_a_reset_and_reports_missed_entries(bench: Bench) -> None:
    """After a reset, later entries run. Entries that were due during the boot are reported as missed and are not run."""
    schedule(bench, 2.5, "SET_EXPOSURE", exposure_ms=77)
    schedule(bench, 6.0, "SET_GAIN", gain=3)
    bench.run(2.2)
    bench.device.power.restart()
    bench.device.reset("watchdog", bench.now_s)
    bench.device._origin_s -= 1.0  # the processor was down for a second
    bench.run(8.0)
    assert entries(bench)[1].values["state"] == "missed"
    assert entries(bench)[2].values["state"] == "done"
    assert bench.tracker.imager.gain == 3
    assert bench.tracker.exposure_ms != 77
    assert ["missed" in e.text for e in bench.device_events("SCHEDULE_FAILED")] == [True]


def test_an_entry_due_during_the_boot_is_missed(make_bench: Callable[..., Bench]) -> None:
    """A command that is due while the device boots is reported as missed with the request id of its SCHEDULE, and is not run
    late."""
    bench = make_bench(timing=UnitTiming(boot_s=3.0))
    bench.until(lambda: bench.host.hello is not None)
    done = schedule(bench, 2.0, "SET_EXPOSURE", exposure_ms=333)
    bench.do("RESET")
    bench.run(8.0)
    (failure,) = bench.device_events("SCHEDULE_FAILED")
    assert ("missed" in failure.text, failure.request_id) == (True, done.request_id)
    assert entries(bench)[1].values["state"] == "missed"
    assert bench.tracker.exposure_ms != 333


def test_a_scheduled_cancel_removes_an_entry_due_at_the_same_time(bench: Bench) -> None:
    """If a scheduled CANCEL and the command that it cancels are due together, the command does not run."""
    at_s = bench.device.time_s + 5.0
    for name, arguments in (("CANCEL", {"schedule_id": 2}), ("SET_EXPOSURE", {"exposure_ms": 333})):
        command = bench.dictionary.command(name)
        payload = encode(command.arguments, check_arguments(command, arguments))
        bench.do("SCHEDULE", at_s=at_s, command_code=command.code, length=len(payload), payload=payload.hex())
    bench.run(7.0)
    assert (entries(bench)[1].values["state"], entries(bench)[2].values["state"]) == ("done", "cancelled")
    assert bench.tracker.exposure_ms != 333
    assert len(bench.device_events("SCHEDULE_RUN")) == 1


def test_the_schedule_survives_the_process(make_bench: Callable[..., Bench]) -> None:
    """Entries are stored in the flash record and run after a restart of the simulator's process."""
    first = make_bench()
    first.until(lambda: first.host.hello is not None)
    schedule(first, 50.0, "SET_GAIN", gain=2)
    first.memory.save()
    first.device.shut_down(first.now_s)
    second = make_bench(memory=first.memory)
    second.until(lambda: second.host.hello is not None)
    assert second.do("LIST_SCHEDULE").values == {"count": 1}
    second.run(60.0)
    assert second.tracker.imager.gain == 2


def test_a_scheduled_reset_runs_once(bench: Bench) -> None:
    """A scheduled RESET runs once, because it is marked as done before it runs."""
    schedule(bench, 1.0, "RESET")
    bench.run(10.0)
    assert bench.memory.record.resets == 1
    assert entries(bench)[1].values["state"] == "done"


def test_an_entry_interrupted_by_a_reset_has_failed(bench: Bench) -> None:
    """An exposure that a reset interrupted is reported as failed once, with the request id of its SCHEDULE."""
    done = schedule(bench, 1.0, "TAKE_IMAGE", exposure_ms=2000)
    bench.run(1.5)
    for _ in range(2):
        bench.device.reset("watchdog", bench.now_s)
        bench.run(3.0)
        (failure,) = bench.device_events("SCHEDULE_FAILED")
    assert ("reset" in failure.text, failure.request_id) == (True, done.request_id)
    last = entries(bench)[1].values
    assert (last["state"], last["reason"]) == ("failed", "reset")


def test_the_schedule_has_sixteen_entries(bench: Bench) -> None:
    """The 17th entry is rejected as ``schedule_full``. CANCEL removes one entry, and CANCEL with id 0 all."""
    for _ in range(16):
        assert schedule(bench, 1000.0, "GET_STATUS").stage is Stage.COMPLETED
    rejected = schedule(bench, 1000.0, "GET_STATUS")
    assert (rejected.stage, rejected.reason) == (Stage.FAILED, "schedule_full")
    assert bench.do("CANCEL", schedule_id=5).values == {"count": 1}
    assert bench.do("CANCEL", schedule_id=5).reason == "not_found"
    assert schedule(bench, 1000.0, "GET_STATUS").stage is Stage.COMPLETED
    assert bench.do("CANCEL", schedule_id=0).values == {"count": 16}
    assert bench.do("CANCEL", schedule_id=0).values == {"count": 0}
    assert bench.status()["scheduled"] == 0


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"command_code": 200}, "unknown_command"),
        ({"command_code": 9}, "wrong_state"),
        ({"command_code": 4}, "wrong_state"),
        ({"length": 1}, "bad_length"),
        ({"command_code": 32, "length": 2, "payload": "0000"}, "out_of_range"),
        ({"command_code": 32, "length": 2, "payload": "07d1"}, "out_of_range"),
        ({"command_code": 16, "length": 1, "payload": "07"}, "out_of_range"),
        ({"at_s": 1.0}, "out_of_range"),
    ],
)
def test_impossible_entries_are_rejected(bench: Bench, change: dict[str, float | str], reason: str) -> None:
    """Entries with unknown or forbidden commands, invalid arguments or a past time are rejected and not stored."""
    bench.run(2.0)
    update = bench.do("SCHEDULE", **({"at_s": 1.0e6, "command_code": 2, "length": 0, "payload": ""} | change))
    assert (update.stage, update.reason) == (Stage.FAILED, reason)
    assert bench.memory.record.schedule == []

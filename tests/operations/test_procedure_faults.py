"""Procedures when commands are unknown, the server's clock jumps, or the store fails."""

from __future__ import annotations

from datetime import timedelta
from typing import Any

import pytest

from gss.domain.errors import Conflict, StoreDown
from gss.operations.procedures.run_record import entries_of, is_intact
from gss.store.commands import Filter

pytestmark = pytest.mark.timeout(180)
IMAGE = "# Image\n\n## image: Take an image\n\n```command\nTAKE_IMAGE\n```\n"
STATUS = "# Status\n\n## status: Ask\n\n```command\nGET_STATUS\n```\n"


def begin(console: Any, text: str, **how: Any) -> Any:
    """Store a procedure and start it."""
    return console.procedure_runs.begin(console.procedures.create(text, user="ann").id, user="ann", **how)


def last(console: Any, run: Any) -> Any:
    """Return the last entry of a run."""
    return entries_of(console.procedure_runs.get(run.id))[-1]


def images(console: Any) -> int:
    """Return how many images the unit has taken."""
    return int(console.sensor.memory.record.frames)


@pytest.fixture
def unknown_image(console: Any, monkeypatch: pytest.MonkeyPatch) -> Any:
    """Run whose unit has taken an image, but whose reports were lost, so that the step has failed."""
    before, run = images(console), begin(console, IMAGE)
    with monkeypatch.context() as patch:
        sends = console.sensor.device.next_frame
        patch.setattr(console.sensor.device, "next_frame", lambda now_s: (sends(now_s), None)[1])
        console.procedure_runs.run_step(run.id, "image", user="ann")
        console.wait(lambda: last(console, run).state == "failed")
    assert "unknown" in last(console, run).detail
    assert images(console) == before + 1
    return run


def test_a_refused_retry_does_not_make_the_next_attempt_a_new_command(console: Any, unknown_image: Any) -> None:
    """The command of the first attempt is sent again with its request id, although a retry was refused meanwhile."""
    before, run = images(console), unknown_image
    console.authority.release("ann")
    console.authority.take("bob")
    with pytest.raises(Conflict, match="held by bob"):
        console.procedure_runs.run_step(run.id, "image", user="ann")
    console.procedure_runs.run_step(run.id, "image", user="bob")
    assert console.run_ends(run).state == "completed"
    [row] = console.history.page(Filter(source="procedure"), 20)
    assert (row.result, row.attempts) == ("completed", 2)
    assert images(console) == before


@pytest.mark.parametrize("survives", [False, True], ids=["the server ends", "the store fails"])
def test_a_retry_whose_record_is_interrupted_is_not_sent_as_a_new_command(
    console: Any, unknown_image: Any, make_console: Any, clock: Any, monkeypatch: pytest.MonkeyPatch, survives: bool
) -> None:
    """The entry names the command before it is sent again, so that its result is found."""
    before, run = images(console), unknown_image
    clock.forward(20)
    with monkeypatch.context() as patch:

        def fails(*_: Any) -> None:
            raise StoreDown("the database is locked")

        patch.setattr(console.procedure_runs._record, "update", fails)
        with pytest.raises(StoreDown):
            console.procedure_runs.run_step(run.id, "image", user="ann")
    if not survives:
        console.wait(lambda: console.history.page(Filter(source="procedure"), 1)[0].result == "completed")
        console = make_console(sensor=console.sensor)
    assert console.run_ends(run).state == "completed"
    assert last(console, run).state == "done"
    assert images(console) == before


def test_a_jump_of_the_clock_does_not_end_a_wait(console: Any, clock: Any) -> None:
    """The wait is measured with the monotonic clock, and the entry shows its end by the corrected clock."""
    text = "# Wait\n\n## cool: Wait\n\n```wait\n40 s\n```\n"
    run = begin(console, text, automatic=True)
    console.wait(lambda: bool(console.procedure_runs.get(run.id).entries))
    began_s = console.sensor.now_s
    clock.forward(900)
    console.wait(lambda: last(console, run).due > clock().isoformat())
    assert last(console, run).state == "running"
    clock.forward(-7200)
    assert console.run_ends(run).state == "completed"
    assert 35 < console.sensor.now_s - began_s < 60


def test_a_clock_that_is_set_back_does_not_hide_new_values_from_a_check(console: Any, clock: Any) -> None:
    """The end of the last command is compared by the present clock. Before, values were ignored for as long as the jump."""
    check = "## check: Cool\n\n```check\nhousekeeping.sensor_temperature_c < 500\nwithin: 30 s\n```\n"
    run = begin(console, f"{STATUS}\n{check}")
    console.procedure_runs.run_step(run.id, "status", user="ann")
    console.wait(lambda: console.procedure_runs.get(run.id).current == "check")
    clock.forward(-3600)
    console.telemetry.board.clock_jumped(clock(), -3600.0)
    console.procedure_runs.run_step(run.id, "check", user="ann")
    assert console.run_ends(run).state == "completed"


def test_a_suspended_check_has_its_time_limit_extended(console: Any, clock: Any) -> None:
    """The time during which a run is suspended does not count, also if the clock jumps meanwhile."""
    check = "# Check\n\n## check: Hot\n\n```check\nhousekeeping.sensor_temperature_c > 500\nwithin: 20 s\n```\n"
    run, began_s = begin(console, check), console.sensor.now_s
    console.procedure_runs.run_step(run.id, "check", user="ann")
    console.procedure_runs.hold(run.id)
    clock.forward(1000)
    console.wait(lambda: console.sensor.now_s > began_s + 30)
    console.procedure_runs.release(run.id)
    console.procedure_runs.tick()
    assert last(console, run).state == "running"
    console.wait(lambda: last(console, run).state == "failed")
    assert console.sensor.now_s > began_s + 45


def test_a_run_that_ended_while_the_store_failed_is_not_active(console: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """The end was stored and only its event was not. The record stays as it is, and another procedure can start."""
    run = begin(console, STATUS)
    record, failures = console.bus.record, []

    def fails_once(kind: str, severity: str, text: str, **data: Any) -> Any:
        if kind == "procedure" and "completed" in text and not failures:
            failures.append(text)
            raise StoreDown("the database is locked")
        return record(kind, severity, text, **data)

    monkeypatch.setattr(console.bus, "record", fails_once)
    console.procedure_runs.run_step(run.id, "status", user="ann")
    console.wait(lambda: bool(failures))
    with pytest.raises(Conflict, match="has ended"):
        console.procedure_runs.stop(run.id, "", user="bob")
    ended = console.procedure_runs.get(run.id)
    assert (ended.state, is_intact(ended)) == ("completed", True)
    assert console.run_ends(begin(console, STATUS.replace("Status", "Again"), automatic=True)).state == "completed"


def test_the_time_of_a_check_begins_at_the_present_clock_after_a_restart(
    console: Any, make_console: Any, clock: Any
) -> None:
    """After a restart, a wait lasts for what the stored time leaves, and at most for its whole time."""
    run, began_s = begin(console, "# Wait\n\n## cool: Wait\n\n```wait\n20 s\n```\n"), console.sensor.now_s
    console.procedure_runs.run_step(run.id, "cool", user="ann")
    clock.at -= timedelta(hours=1)
    restarted = make_console(sensor=console.sensor)
    assert restarted.run_ends(run).state == "completed"
    assert console.sensor.now_s < began_s + 60

"""Stacks of commands: checked when stored, previewed in a dry run, run step by step, and ended by any deviation."""

from __future__ import annotations

from typing import Any

import pytest

from gss.domain.errors import BadInput, Conflict, NotFound

pytestmark = pytest.mark.timeout(120)

STATUS = {"command": "GET_STATUS"}
ERASE = {"command": "ERASE_BANK", "arguments": {"bank": "C"}}


@pytest.fixture
def console(make_console):
    """Operator console whose sensor has identified itself."""
    return make_console()


def store_stack(console, *steps: Any, name: str = "s") -> Any:
    return console.stacks.create(name, "", steps, user="ann")


def states(run: Any) -> list[str]:
    return [step["state"] for step in run.steps]


# --- storing
# -----------------------------------------------------------------------------------------------------------


def test_a_stack_is_stored_in_full_changed_and_deleted(console):
    """A stack is stored with its defaults, so that defaults of a later dictionary do not change it. It can be changed and
    deleted."""
    row = store_stack(console, {"command": "TAKE_IMAGE", "delay_s": 2, "note": "first light"}, name=" two  words ")
    assert row.name == "two words"
    assert row.steps == [
        {
            "command": "TAKE_IMAGE",
            "arguments": {"slot": 0, "exposure_ms": 0},
            "delay_s": 2.0,
            "condition": None,
            "note": "first light",
        }
    ]
    with pytest.raises(Conflict, match="a stack with this name exists"):
        store_stack(console, STATUS, name="two words")
    changed = console.stacks.change(row.id, "three", "n", [STATUS], user="bob")
    assert (changed.name, changed.author, len(changed.steps)) == ("three", "bob", 1)
    assert [s.name for s in console.stacks.every()] == ["three"]
    console.stacks.delete(row.id)
    with pytest.raises(NotFound):
        console.stacks.get(row.id)


@pytest.mark.parametrize(
    ("step", "words"),
    [
        ({"command": "MAKE_COFFEE"}, "unknown command"),
        ({"command": "ABORT"}, "cannot be a step"),
        ({"command": "SET_EXPOSURE", "arguments": {"exposure_ms": 99_999}}, "1 – 2000"),
        ({"command": "SET_EXPOSURE", "arguments": {"exposure": 5}}, "unknown argument"),
        ({"command": "GET_STATUS", "delay_s": -1}, "delay_s"),
        ({"command": "GET_STATUS", "delay_s": float("nan")}, "delay_s"),
        ({"command": "GET_STATUS", "delay": 1}, "not a step"),
        ({"command": "GET_STATUS", "condition": {"field": "phase", "op": "eq", "value": 1}}, "no such field"),
        (
            {"command": "GET_STATUS", "condition": {"field": "mode", "op": "is", "value": "standby"}},
            "unknown comparison",
        ),
        ({"command": "GET_STATUS", "condition": {"field": "mode", "op": "eq", "value": "asleep"}}, "no such choice"),
        (
            {"command": "GET_STATUS", "condition": {"field": "mode", "op": "gt", "value": "standby"}},
            "does not support this comparison",
        ),
        (
            {"command": "GET_STATUS", "condition": {"field": "cycle_running", "op": "eq", "value": 1}},
            "does not support this comparison",
        ),
        ({"command": "GET_STATUS", "condition": {"field": "gain", "op": "eq", "value": 1, "wait_s": 0}}, "wait_s"),
        ({"command": "GET_STATUS", "condition": {"packet": "x", "field": "gain", "op": "eq", "value": 1}}, "packet"),
    ],
)
def test_an_invalid_step_is_named_and_nothing_is_stored(console, step, words):
    """Every step is checked against the dictionary before the stack is stored."""
    with pytest.raises(BadInput, match=rf"step 2: .*{words}"):
        store_stack(console, STATUS, step)
    assert console.stacks.every() == []


def test_an_exported_stack_is_unchanged_by_import(console):
    """A stack that was exported, deleted and imported has the same steps."""
    steps = (STATUS, ERASE, {"command": "GET_STATUS", "condition": {"field": "gain", "op": "ge", "value": 1}})
    row = store_stack(console, *steps)
    file = console.stacks.exported(row.id)
    console.stacks.delete(row.id)
    assert console.stacks.create(file["name"], file["note"], file["steps"], user="bob").steps == row.steps


# --- dry run -----------------------------------------------------------------------------------------------------------


def test_a_dry_run_lists_bytes_hazards_and_times_and_sends_nothing(console):
    """A dry run lists the packet and hazard of each step, the names to confirm, and the shortest and longest time. Nothing
    is sent."""
    written = len(b"".join(console.sensor.written))
    wait = {"field": "cycle_running", "op": "eq", "value": False, "wait_s": 30}
    steps = [
        {"command": "POWER", "arguments": {"state": "off"}, "delay_s": 5},
        ERASE,
        STATUS | {"condition": wait},
        ERASE,
    ]
    check = console.stacks.check(steps, user="ann")
    assert check.confirm == ["POWER", "ERASE_BANK"]
    assert [s.risk.hazard for s in check.steps] == ["warning", "critical", "none", "critical"]
    assert dict(check.steps[1].groups)["bank"] == b"\2"
    assert check.problems == []
    assert check.shortest_s == 5.0
    windows_s = sum(c.accept_s + c.complete_s for c in (console.link.dictionary.command(s["command"]) for s in steps))
    assert check.longest_s == 5.0 + 30.0 + windows_s
    assert len(b"".join(console.sensor.written)) == written
    invalid = console.stacks.check([STATUS, {"command": "SET_EXPOSURE", "arguments": {"exposure_ms": 0}}], user="ann")
    assert [p[:7] for p in invalid.problems] == ["step 2:"]


# --- running -----------------------------------------------------------------------------------------------------------


def test_a_run_executes_its_steps_in_order_with_delay_and_condition(console):
    """Steps run in order, after their delay and when their condition is met. Each command is recorded with its run."""
    stopped = {"field": "cycle_running", "op": "eq", "value": False, "wait_s": 20}
    running = {"field": "cycle_running", "op": "eq", "value": True, "wait_s": 20}
    steps = [
        {"command": "SET_MODE", "arguments": {"mode": "lost_in_space"}},
        {"command": "START_CYCLE"},
        {"command": "STOP_CYCLE", "condition": running},
        {"command": "TAKE_IMAGE", "condition": stopped, "delay_s": 3},
    ]
    subscription = console.bus.subscribe(lambda: None)
    began_s = console.sensor.now_s
    run = console.run_ends(console.runs.run(store_stack(console, *steps).id, [], user="ann"))
    assert (run.state, run.reason, states(run)) == ("completed", "", ["completed"] * 4)
    assert console.sensor.now_s - began_s >= 3
    rows = [console.commands.get(step["command_id"]) for step in run.steps]
    assert [row.name for row in rows] == [step["command"] for step in steps]
    assert {(row.run_id, row.source, row.user) for row in rows} == {(run.id, "stack", "ann")}
    published = [m.payload for m in subscription.take()[0] if m.topic == "stack_run"]
    assert [row.state for row in published][-1] == "completed"
    assert {step["state"] for row in published for step in row.steps} >= {"waiting", "delay", "condition", "sending"}


def test_names_are_typed_once_before_the_run(console):
    """A run is rejected without the names of its hazardous commands. With them no further confirmation is needed."""
    stack = store_stack(console, STATUS, {"command": "POWER", "arguments": {"state": "off"}}, {"command": "RESET"})
    for typed in ([], ["POWER"], ["power", "reset"]):
        with pytest.raises(BadInput, match="need confirmation") as caught:
            console.runs.run(stack.id, typed, user="ann")
        assert "RESET" in caught.value.expected
    assert console.runs.newest(5) == []
    run = console.run_ends(console.runs.run(stack.id, ["POWER", "RESET"], user="ann"))
    assert states(run)[:2] == ["completed", "completed"]


def test_a_failed_command_ends_the_run(console):
    """A command that fails ends the run, and the reason names it."""
    run = console.run_ends(
        console.runs.run(store_stack(console, STATUS, {"command": "FIND_CENTROIDS"}, STATUS).id, [], user="ann")
    )
    assert (run.state, run.step, states(run)) == ("failed", 1, ["completed", "failed", "waiting"])
    assert "step 2, FIND_CENTROIDS: failed no_image" in run.reason


def test_a_missing_report_ends_the_run_and_nothing_is_repeated(console):
    """A command with an unknown result ends the run and is not repeated."""
    console.sensor.deaf = True
    run = console.run_ends(console.runs.run(store_stack(console, {"command": "TAKE_IMAGE"}, STATUS).id, [], user="ann"))
    assert (run.state, states(run)) == ("failed", ["unknown", "waiting"])
    assert console.commands.get(run.steps[0]["command_id"]).attempts == 1


def test_a_condition_that_is_not_met_ends_the_run(console):
    """If a condition is not met within its timeout, the run ends with the actual value, and the command is not sent."""
    wait = {"field": "cycle_running", "op": "eq", "value": True, "wait_s": 3}
    run = console.run_ends(console.runs.run(store_stack(console, STATUS | {"condition": wait}).id, [], user="ann"))
    assert (run.state, run.steps[0]["command_id"]) == ("failed", None)
    assert "cycle_running eq True not met within 3 s; cycle_running: False" in run.reason


def test_a_command_that_is_not_allowed_ends_the_run(console):
    """Preconditions are checked when the step is reached. If one is not met, the run ends."""
    steps = ({"command": "SET_MODE", "arguments": {"mode": "standby"}}, STATUS, {"command": "START_CYCLE"})
    run = console.run_ends(console.runs.run(store_stack(console, *steps).id, [], user="ann"))
    assert (run.state, run.step) == ("failed", 2)
    assert "standby" in run.reason


def test_a_run_is_paused_resumed_and_stopped(console):
    """A paused run sends nothing and can be resumed. A stopped run has ended, and further requests are rejected."""
    stack = store_stack(console, STATUS | {"delay_s": 2}, STATUS, STATUS | {"delay_s": 3600})
    run = console.runs.run(stack.id, [], user="ann")
    assert console.runs.pause(run.id, user="ann").state == "paused"
    later_s = console.sensor.now_s + 10
    console.wait(lambda: console.sensor.now_s > later_s)
    assert states(console.runs.get(run.id))[1] == "waiting"
    with pytest.raises(Conflict, match="a stack is running"):
        console.runs.run(stack.id, [], user="ann")
    assert console.runs.resume(run.id, user="ann").state == "running"
    console.wait(lambda: states(console.runs.get(run.id))[2] == "delay")
    row = console.run_ends(console.runs.stop(run.id, user="bob"))
    assert (row.state, row.reason, states(row)) == ("stopped", "stopped by bob", ["completed", "completed", "stopped"])
    for order in (console.runs.pause, console.runs.resume, console.runs.stop):
        with pytest.raises(Conflict, match="has ended"):
            order(run.id, user="ann")


def test_abort_stops_the_run_and_is_sent_before_it(console):
    """ABORT of any user is sent immediately and stops the run."""
    steps = ({"command": "RUN_ITERATION"}, {"command": "RUN_ITERATION"}, {"command": "RUN_ITERATION"})
    console.end(console.send("SET_MODE", mode="lost_in_space"))
    run = console.runs.run(store_stack(console, *steps).id, [], user="ann")
    console.wait(lambda: any(r.result in ("started", "progress") for r in console.history.page(_of(run), 5)))
    abort = console.end(console.commands.abort(user="bob", source="abort").row(20))
    row = console.run_ends(run)
    assert abort.result == "completed"
    assert (row.state, row.reason) == ("stopped", "ABORT by bob")
    assert len(console.history.page(_of(run), 5)) == 1


def _of(run: Any) -> Any:
    from gss.operations.commanding.command_history import Filter

    return Filter(run_id=run.id)


def test_a_run_needs_command_authority_and_ends_when_it_is_broken(console):
    """A user without command authority cannot start a run. When authority is broken, the run ends at its next step."""
    console.authority.take("ann")
    stack = store_stack(console, STATUS, STATUS | {"delay_s": 20})
    with pytest.raises(Conflict, match="held by ann"):
        console.runs.run(stack.id, [], user="bob")
    run = console.runs.run(stack.id, [], user="ann")
    console.wait(lambda: states(console.runs.get(run.id))[1] == "delay")
    console.authority.break_("bob", "pass begins")
    row = console.run_ends(run)
    assert (row.state, states(row)) == ("failed", ["completed", "failed"])
    assert "held by bob" in row.reason


def test_a_lost_link_ends_the_run(console):
    """If the link is lost, the command in progress is unknown and the run ends. A run without a link is rejected."""
    image = {"command": "TAKE_IMAGE", "arguments": {"exposure_ms": 2000}}
    run = console.runs.run(store_stack(console, image, STATUS).id, [], user="ann")
    console.wait(lambda: [r.result for r in console.history.page(_of(run), 5)] == ["started"])
    console.sensor.cut = True
    row = console.run_ends(run)
    assert (row.state, states(row)) == ("failed", ["unknown", "waiting"])
    late = store_stack(console, STATUS | {"delay_s": 1}, name="later")
    assert any("line is down" in p for p in console.stacks.check(late.steps, user="ann").problems)
    with pytest.raises(Conflict, match="cannot run in the current state"):
        console.runs.run(late.id, [], user="ann")


def test_a_queued_command_is_withdrawn_when_the_link_is_lost(console):
    """A step that is queued when the link is lost is withdrawn, so that it is not sent in the next contact."""
    image = console.send("TAKE_IMAGE", exposure_ms=2000)
    console.wait(lambda: console.commands.get(image.id).result == "started")
    run = console.runs.run(store_stack(console, {"command": "SET_EXPOSURE"}).id, [], user="ann")
    console.wait(lambda: len(console.history.page(_of(run), 5)) == 1)
    console.sensor.cut = True
    row = console.run_ends(run)
    assert (row.state, states(row)) == ("failed", ["withdrawn"])


def test_a_run_ends_with_the_server(make_console, database):
    """A run in progress is stopped at the next start of the server, with the reason, and nothing is sent."""
    from gss.store import stacks as store
    from gss.store.models import StackRun

    first = make_console()
    stack = store_stack(first, STATUS, STATUS)
    with database.unit_of_work() as session:
        steps = [dict(s) | {"state": "waiting", "command_id": None, "detail": ""} for s in stack.steps]
        interrupted = StackRun(
            stack_id=stack.id,
            name="s",
            steps=steps,
            state="running",
            step=1,
            reason="",
            user="ann",
            started=first.link._now(),
        )
        store.add(session, interrupted)
    second = make_console(first.sensor)
    row = second.runs.get(interrupted.id)
    assert (row.state, row.reason) == ("stopped", "stopped: server restarted")
    assert second.history.page(_of(interrupted), 5) == []
    second.stacks.delete(stack.id)
    assert second.runs.get(interrupted.id).stack_id is None


# --- resumed
# ------------------------------------------------------------------------------------------------------------


def test_a_failed_step_is_retried_or_skipped_with_a_reason(console):
    """A retry sends the failed step as a new command. A skip continues after it and stores the reason with the step."""
    steps = (STATUS, {"command": "FIND_CENTROIDS"}, STATUS)
    run = console.run_ends(console.runs.run(store_stack(console, *steps).id, [], user="ann"))
    first = run.steps[1]["command_id"]
    retried = console.run_ends(console.runs.continue_run(run.id, "", [], user="ann"))
    assert (retried.id, retried.state, states(retried)) == (run.id, "failed", ["completed", "failed", "waiting"])
    assert retried.steps[0]["command_id"] == run.steps[0]["command_id"]
    assert retried.steps[1]["command_id"] > first
    skipped_run = console.run_ends(console.runs.continue_run(run.id, "no image tonight", [], user="ann"))
    assert (skipped_run.state, states(skipped_run)) == ("completed", ["completed", "skipped", "completed"])
    assert skipped_run.steps[1]["detail"].startswith("by ann: no image tonight; previously failed no_image")
    with pytest.raises(Conflict, match="only a failed run"):
        console.runs.continue_run(run.id, "", [], user="ann")


def test_a_step_with_unknown_result_is_retried_with_its_id(console):
    """A step with an unknown result is retried with the same command id, so that the device executes it once."""
    console.sensor.deaf = True
    run = console.run_ends(console.runs.run(store_stack(console, {"command": "TAKE_IMAGE"}).id, [], user="ann"))
    assert states(run) == ["unknown"]
    console.sensor.deaf = False
    retried = console.run_ends(console.runs.continue_run(run.id, "", [], user="ann"))
    assert (retried.state, states(retried)) == ("completed", ["completed"])
    assert retried.steps[0]["command_id"] == run.steps[0]["command_id"]
    assert console.commands.get(retried.steps[0]["command_id"]).attempts == 2


def test_hazards_after_the_failed_step_are_confirmed_again(console):
    """The names that confirmed a failed run do not apply to its continuation. Only the last run can be continued."""
    stack = store_stack(console, {"command": "FIND_CENTROIDS"}, {"command": "POWER", "arguments": {"state": "off"}})
    run = console.run_ends(console.runs.run(stack.id, ["POWER"], user="ann"))
    with pytest.raises(BadInput, match="need confirmation"):
        console.runs.continue_run(run.id, "not needed", [], user="ann")
    later = console.run_ends(
        console.runs.run(store_stack(console, {"command": "FIND_CENTROIDS"}, name="t").id, [], user="ann")
    )
    with pytest.raises(Conflict, match="another stack has run since"):
        console.runs.continue_run(run.id, "not needed", ["POWER"], user="ann")
    assert console.run_ends(console.runs.continue_run(later.id, "not needed", [], user="ann")).state == "completed"

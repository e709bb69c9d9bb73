"""Stacks of commands: checked when kept, tried dry, run step by step, and ended by whatever is not as it should be."""

from __future__ import annotations

from typing import Any

import pytest

from gss.domain.errors import BadInput, Conflict, NotFound

pytestmark = pytest.mark.timeout(120)

STATUS = {"command": "GET_STATUS"}
ERASE = {"command": "ERASE_BANK", "arguments": {"bank": "C"}}


@pytest.fixture
def desk(make_desk):
    """A desk with a sensor that has answered."""
    return make_desk()


def kept(desk, *steps: Any, name: str = "s") -> Any:
    return desk.stacks.create(name, "", steps, user="ann")


def states(run: Any) -> list[str]:
    return [step["state"] for step in run.steps]


# --- keeping -----------------------------------------------------------------------------------------------------------


def test_a_stack_is_kept_in_full_and_changed_and_forgotten(desk):
    """Defaults are filled in, so that a later dictionary's defaults do not change it."""
    row = kept(desk, {"command": "TAKE_IMAGE", "delay_s": 2, "note": "first light"}, name=" two  words ")
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
    with pytest.raises(Conflict, match="another stack has this name"):
        kept(desk, STATUS, name="two words")
    changed = desk.stacks.change(row.id, "three", "n", [STATUS], user="bob")
    assert (changed.name, changed.author, len(changed.steps)) == ("three", "bob", 1)
    assert [s.name for s in desk.stacks.every()] == ["three"]
    desk.stacks.delete(row.id)
    with pytest.raises(NotFound):
        desk.stacks.get(row.id)


@pytest.mark.parametrize(
    ("step", "words"),
    [
        ({"command": "MAKE_COFFEE"}, "unknown command"),
        ({"command": "ABORT"}, "lane of its own"),
        ({"command": "SET_EXPOSURE", "arguments": {"exposure_ms": 99_999}}, "1 – 2000"),
        ({"command": "SET_EXPOSURE", "arguments": {"exposure": 5}}, "unknown argument"),
        ({"command": "GET_STATUS", "delay_s": -1}, "delay_s"),
        ({"command": "GET_STATUS", "delay_s": float("nan")}, "delay_s"),
        ({"command": "GET_STATUS", "delay": 1}, "not a step"),
        ({"command": "GET_STATUS", "condition": {"field": "phase", "op": "eq", "value": 1}}, "no such field"),
        (
            {"command": "GET_STATUS", "condition": {"field": "mode", "op": "is", "value": "standby"}},
            "no such comparison",
        ),
        ({"command": "GET_STATUS", "condition": {"field": "mode", "op": "eq", "value": "asleep"}}, "no such choice"),
        (
            {"command": "GET_STATUS", "condition": {"field": "mode", "op": "gt", "value": "standby"}},
            "cannot be compared",
        ),
        (
            {"command": "GET_STATUS", "condition": {"field": "cycle_running", "op": "eq", "value": 1}},
            "cannot be compared",
        ),
        ({"command": "GET_STATUS", "condition": {"field": "gain", "op": "eq", "value": 1, "wait_s": 0}}, "wait_s"),
        ({"command": "GET_STATUS", "condition": {"packet": "x", "field": "gain", "op": "eq", "value": 1}}, "packet"),
    ],
)
def test_a_bad_step_is_named_and_nothing_is_kept(desk, step, words):
    """Every step is checked against the dictionary before the stack is kept."""
    with pytest.raises(BadInput, match=rf"step 2: .*{words}"):
        kept(desk, STATUS, step)
    assert desk.stacks.every() == []


def test_an_exported_stack_is_the_same_when_it_comes_back(desk):
    """Export, forget, import."""
    steps = (STATUS, ERASE, {"command": "GET_STATUS", "condition": {"field": "gain", "op": "ge", "value": 1}})
    row = kept(desk, *steps)
    file = desk.stacks.exported(row.id)
    desk.stacks.delete(row.id)
    assert desk.stacks.create(file["name"], file["note"], file["steps"], user="bob").steps == row.steps


# --- dry run -----------------------------------------------------------------------------------------------------------


def test_a_dry_run_tells_bytes_hazards_and_times_and_sends_nothing(desk):
    """Every step with its packet; the names to type, each once; shortest and longest time."""
    written = len(b"".join(desk.sensor.written))
    wait = {"field": "cycle_running", "op": "eq", "value": False, "wait_s": 30}
    steps = [
        {"command": "POWER", "arguments": {"state": "off"}, "delay_s": 5},
        ERASE,
        STATUS | {"condition": wait},
        ERASE,
    ]
    check = desk.stacks.check(steps, user="ann")
    assert check.confirm == ["POWER", "ERASE_BANK"]
    assert [s.risk.hazard for s in check.steps] == ["warning", "critical", "none", "critical"]
    assert dict(check.steps[1].groups)["bank"] == b"\2"
    assert check.problems == []
    assert check.shortest_s == 5.0
    windows_s = sum(c.accept_s + c.complete_s for c in (desk.link.dictionary.command(s["command"]) for s in steps))
    assert check.longest_s == 5.0 + 30.0 + windows_s
    assert len(b"".join(desk.sensor.written)) == written
    bad = desk.stacks.check([STATUS, {"command": "SET_EXPOSURE", "arguments": {"exposure_ms": 0}}], user="ann")
    assert [p[:7] for p in bad.problems] == ["step 2:"]


# --- running -----------------------------------------------------------------------------------------------------------


def test_a_run_goes_through_its_steps_in_order_with_delay_and_condition(desk):
    """Delay, condition on telemetry that came after the step before, command; each step's command is on the record."""
    stopped = {"field": "cycle_running", "op": "eq", "value": False, "wait_s": 20}
    running = {"field": "cycle_running", "op": "eq", "value": True, "wait_s": 20}
    steps = [
        {"command": "SET_MODE", "arguments": {"mode": "lost_in_space"}},
        {"command": "START_CYCLE"},
        {"command": "STOP_CYCLE", "condition": running},
        {"command": "TAKE_IMAGE", "condition": stopped, "delay_s": 3},
    ]
    subscription = desk.bus.subscribe(lambda: None)
    began_s = desk.sensor.now_s
    run = desk.run_ends(desk.runs.run(kept(desk, *steps).id, [], user="ann"))
    assert (run.state, run.reason, states(run)) == ("completed", "", ["completed"] * 4)
    assert desk.sensor.now_s - began_s >= 3
    rows = [desk.commands.get(step["command_id"]) for step in run.steps]
    assert [row.name for row in rows] == [step["command"] for step in steps]
    assert {(row.run_id, row.source, row.user) for row in rows} == {(run.id, "stack", "ann")}
    told = [m.payload for m in subscription.take()[0] if m.topic == "stack_run"]
    assert [row.state for row in told][-1] == "completed"
    assert {step["state"] for row in told for step in row.steps} >= {"waiting", "delay", "condition", "sending"}


def test_names_are_typed_once_before_the_run(desk):
    """Without them nothing is sent; with them the hazardous steps go out without further question."""
    stack = kept(desk, STATUS, {"command": "POWER", "arguments": {"state": "off"}}, {"command": "RESET"})
    for typed in ([], ["POWER"], ["power", "reset"]):
        with pytest.raises(BadInput, match="must be confirmed") as caught:
            desk.runs.run(stack.id, typed, user="ann")
        assert "RESET" in caught.value.expected
    assert desk.runs.newest(5) == []
    run = desk.run_ends(desk.runs.run(stack.id, ["POWER", "RESET"], user="ann"))
    assert states(run)[:2] == ["completed", "completed"]


def test_what_fails_ends_the_run(desk):
    """The first command that is not completed is the last; the reason names it."""
    run = desk.run_ends(desk.runs.run(kept(desk, STATUS, {"command": "FIND_CENTROIDS"}, STATUS).id, [], user="ann"))
    assert (run.state, run.step, states(run)) == ("failed", 1, ["completed", "failed", "waiting"])
    assert "step 2, FIND_CENTROIDS: failed no_image" in run.reason


def test_silence_ends_the_run_and_nothing_is_repeated(desk):
    """Unknown is not success: the run stops, and the command is the operator's to settle."""
    desk.sensor.deaf = True
    run = desk.run_ends(desk.runs.run(kept(desk, {"command": "TAKE_IMAGE"}, STATUS).id, [], user="ann"))
    assert (run.state, states(run)) == ("failed", ["unknown", "waiting"])
    assert desk.commands.get(run.steps[0]["command_id"]).attempts == 1


def test_a_condition_that_is_not_met_ends_the_run(desk):
    """Its time is over: the value that stood against it is told, and the command never goes out."""
    wait = {"field": "cycle_running", "op": "eq", "value": True, "wait_s": 3}
    run = desk.run_ends(desk.runs.run(kept(desk, STATUS | {"condition": wait}).id, [], user="ann"))
    assert (run.state, run.steps[0]["command_id"]) == ("failed", None)
    assert "cycle_running eq True not met within 3 s; cycle_running: False" in run.reason


def test_a_command_that_is_not_allowed_ends_the_run(desk):
    """Preconditions are looked at when the step's turn comes."""
    steps = ({"command": "SET_MODE", "arguments": {"mode": "standby"}}, STATUS, {"command": "START_CYCLE"})
    run = desk.run_ends(desk.runs.run(kept(desk, *steps).id, [], user="ann"))
    assert (run.state, run.step) == ("failed", 2)
    assert "standby" in run.reason


def test_a_run_is_paused_resumed_and_stopped(desk):
    """Paused it sends nothing more; stopped it ends, and what was sent is followed on its own."""
    stack = kept(desk, STATUS | {"delay_s": 2}, STATUS, STATUS | {"delay_s": 3600})
    run = desk.runs.run(stack.id, [], user="ann")
    assert desk.runs.pause(run.id, user="ann").state == "paused"
    later_s = desk.sensor.now_s + 10
    desk.wait(lambda: desk.sensor.now_s > later_s)
    assert states(desk.runs.get(run.id))[1] == "waiting"
    with pytest.raises(Conflict, match="a stack is running"):
        desk.runs.run(stack.id, [], user="ann")
    assert desk.runs.resume(run.id, user="ann").state == "running"
    desk.wait(lambda: states(desk.runs.get(run.id))[2] == "delay")
    row = desk.run_ends(desk.runs.stop(run.id, user="bob"))
    assert (row.state, row.reason, states(row)) == ("stopped", "stopped by bob", ["completed", "completed", "stopped"])
    for order in (desk.runs.pause, desk.runs.resume, desk.runs.stop):
        with pytest.raises(Conflict, match="has ended"):
            order(run.id, user="ann")


def test_abort_stops_the_run_and_goes_out_past_it(desk):
    """ABORT of anybody: at once on the line, and no further step."""
    steps = ({"command": "RUN_ITERATION"}, {"command": "RUN_ITERATION"}, {"command": "RUN_ITERATION"})
    desk.end(desk.send("SET_MODE", mode="lost_in_space"))
    run = desk.runs.run(kept(desk, *steps).id, [], user="ann")
    desk.wait(lambda: any(r.result in ("started", "progress") for r in desk.history.page(_of(run), 5)))
    abort = desk.end(desk.commands.abort(user="bob", source="abort").row(20))
    row = desk.run_ends(run)
    assert abort.result == "completed"
    assert (row.state, row.reason) == ("stopped", "ABORT by bob")
    assert len(desk.history.page(_of(run), 5)) == 1


def _of(run: Any) -> Any:
    from gss.operations.commanding.command_history import Filter

    return Filter(run_id=run.id)


def test_a_run_needs_command_authority_and_ends_when_it_is_broken(desk):
    """Nobody else starts one meanwhile; whoever breaks authority ends it at its next step."""
    desk.authority.take("ann")
    stack = kept(desk, STATUS, STATUS | {"delay_s": 20})
    with pytest.raises(Conflict, match="held by ann"):
        desk.runs.run(stack.id, [], user="bob")
    run = desk.runs.run(stack.id, [], user="ann")
    desk.wait(lambda: states(desk.runs.get(run.id))[1] == "delay")
    desk.authority.break_("bob", "pass begins")
    row = desk.run_ends(run)
    assert (row.state, states(row)) == ("failed", ["completed", "failed"])
    assert "held by bob" in row.reason


def test_a_lost_line_ends_the_run(desk):
    """The command under way is unknown; what had not been sent does not wait for the next contact."""
    image = {"command": "TAKE_IMAGE", "arguments": {"exposure_ms": 2000}}
    run = desk.runs.run(kept(desk, image, STATUS).id, [], user="ann")
    desk.wait(lambda: [r.result for r in desk.history.page(_of(run), 5)] == ["started"])
    desk.sensor.cut = True
    row = desk.run_ends(run)
    assert (row.state, states(row)) == ("failed", ["unknown", "waiting"])
    late = kept(desk, STATUS | {"delay_s": 1}, name="later")
    assert any("line is down" in p for p in desk.stacks.check(late.steps, user="ann").problems)
    with pytest.raises(Conflict, match="cannot run now"):
        desk.runs.run(late.id, [], user="ann")


def test_a_command_that_waits_when_the_line_goes_is_taken_back(desk):
    """A step that was queued behind another command does not go out in the next contact, when nobody expects it."""
    image = desk.send("TAKE_IMAGE", exposure_ms=2000)
    desk.wait(lambda: desk.commands.get(image.id).result == "started")
    run = desk.runs.run(kept(desk, {"command": "SET_EXPOSURE"}).id, [], user="ann")
    desk.wait(lambda: len(desk.history.page(_of(run), 5)) == 1)
    desk.sensor.cut = True
    row = desk.run_ends(run)
    assert (row.state, states(row)) == ("failed", ["withdrawn"])


def test_a_run_does_not_outlive_the_server(make_desk, database):
    """The next server finds it under way, says why it ended, and sends nothing."""
    from gss.store import stacks as store
    from gss.store.models import StackRun

    first = make_desk()
    stack = kept(first, STATUS, STATUS)
    with database.unit_of_work() as session:
        steps = [dict(s) | {"state": "waiting", "command_id": None, "detail": ""} for s in stack.steps]
        left = StackRun(
            stack_id=stack.id,
            name="s",
            steps=steps,
            state="running",
            step=1,
            reason="",
            user="ann",
            started=first.link._now(),
        )
        store.add(session, left)
    second = make_desk(first.sensor)
    row = second.runs.get(left.id)
    assert (row.state, row.reason) == ("stopped", "stopped: server restarted")
    assert second.history.page(_of(left), 5) == []
    second.stacks.delete(stack.id)
    assert second.runs.get(left.id).stack_id is None


# --- taken up again ----------------------------------------------------------------------------------------------------


def test_a_failed_step_is_tried_again_or_passed_with_a_reason(desk):
    """Retry sends it as a new command; skip goes on behind it, and the reason stands beside the step."""
    steps = (STATUS, {"command": "FIND_CENTROIDS"}, STATUS)
    run = desk.run_ends(desk.runs.run(kept(desk, *steps).id, [], user="ann"))
    first = run.steps[1]["command_id"]
    again = desk.run_ends(desk.runs.go_on(run.id, "", [], user="ann"))
    assert (again.id, again.state, states(again)) == (run.id, "failed", ["completed", "failed", "waiting"])
    assert again.steps[0]["command_id"] == run.steps[0]["command_id"]
    assert again.steps[1]["command_id"] > first
    passed = desk.run_ends(desk.runs.go_on(run.id, "no image tonight", [], user="ann"))
    assert (passed.state, states(passed)) == ("completed", ["completed", "skipped", "completed"])
    assert passed.steps[1]["detail"].startswith("by ann: no image tonight; before failed no_image")
    with pytest.raises(Conflict, match="only a run that failed"):
        desk.runs.go_on(run.id, "", [], user="ann")


def test_a_step_of_unknown_fate_is_tried_again_with_its_id(desk):
    """The device runs it once, whether the first one came through or not."""
    desk.sensor.deaf = True
    run = desk.run_ends(desk.runs.run(kept(desk, {"command": "TAKE_IMAGE"}).id, [], user="ann"))
    assert states(run) == ["unknown"]
    desk.sensor.deaf = False
    again = desk.run_ends(desk.runs.go_on(run.id, "", [], user="ann"))
    assert (again.state, states(again)) == ("completed", ["completed"])
    assert again.steps[0]["command_id"] == run.steps[0]["command_id"]
    assert desk.commands.get(again.steps[0]["command_id"]).attempts == 2


def test_hazards_behind_the_failed_step_are_confirmed_anew(desk):
    """Names typed for a run that failed do not hold for the next try; a last step that is passed needs none."""
    stack = kept(desk, {"command": "FIND_CENTROIDS"}, {"command": "POWER", "arguments": {"state": "off"}})
    run = desk.run_ends(desk.runs.run(stack.id, ["POWER"], user="ann"))
    with pytest.raises(BadInput, match="must be confirmed"):
        desk.runs.go_on(run.id, "not needed", [], user="ann")
    later = desk.run_ends(desk.runs.run(kept(desk, {"command": "FIND_CENTROIDS"}, name="t").id, [], user="ann"))
    with pytest.raises(Conflict, match="another stack ran since"):
        desk.runs.go_on(run.id, "not needed", ["POWER"], user="ann")
    assert desk.run_ends(desk.runs.go_on(later.id, "not needed", [], user="ann")).state == "completed"

"""Pass plans with a simulated sensor and clock: acquisition, loss of signal, next pass, ABORT and restart."""

from __future__ import annotations

from dataclasses import replace
from datetime import timedelta
from typing import Any, cast

import pytest

from gss.domain.errors import BadInput, Conflict, NotPermitted, StoreDown
from gss.operations.passes.line_budget import LineBudgetService
from gss.operations.passes.pass_table import PassService
from gss.operations.passes.plan_items import ItemControl, PlanItem
from gss.operations.passes.plan_runner import PlanRunner
from gss.operations.passes.plans import PlanService, items_of
from gss.operations.passes.spacecraft import SpacecraftService
from gss.operations.passes.stations import StationService
from gss.operations.procedures.procedures import hash_of
from gss.operations.procedures.run_record import is_intact
from gss.orbit.station import GroundStation
from gss.store import commands as store

pytestmark = pytest.mark.timeout(120)
STATUS, STANDBY, WAIT = ("command", "GET_STATUS"), ("command", "SET_MODE mode=standby"), ("wait", "10 min")
STELLENBOSCH = GroundStation("Stellenbosch", -0.59215, 0.32926, 136.0, 0.0873)


class Mission:
    """Passes and plans on a console. Its plans have procedures, but no transfers."""

    def __init__(self, console: Any, database: Any, bus: Any, clock: Any, tle: str) -> None:
        self.console, self.clock, self.bus = console, clock, bus
        spacecraft, stations = SpacecraftService(database, bus, clock), StationService(database, bus, clock)
        self.table = PassService(spacecraft, stations, LineBudgetService(console.link, database), clock)
        none = cast(Any, None)
        control = ItemControl(console.procedures, console.procedure_runs, none, none, none, console._permits)
        self.plans = PlanService(self.table, spacecraft, control, console.commands, database, bus, clock)
        self.runner = PlanRunner(self.plans, control, self.table, console.link, console.commands, bus, clock)
        if not stations.list_all():
            stations.create(STELLENBOSCH, "", 0, "", user="ann")
            spacecraft.set(tle, name="", source="", user="ann")

    def quick(self, *blocks: tuple[str, str], name: str) -> PlanItem:
        """Store a procedure of (kind, content) blocks and return its item."""
        steps = [f"## s{k}: Step\n\n```{kind}\n{content}\n```\n" for k, (kind, content) in enumerate(blocks)]
        return self.procedure(f"# {name}\n\n" + "\n".join(steps))

    def procedure(self, text: str) -> PlanItem:
        row = self.console.procedures.create(text, user="ann")
        return PlanItem("procedure", "", 30.0, procedure_id=row.id)

    def plan(self, *items: PlanItem, resume: bool = False, name: str = "p") -> Any:
        first = next(p for p in self.table.upcoming(3).passes if p.at.rise > self.clock.at + timedelta(minutes=5))
        return self.plans.create(name, first.station.id, first.at.culmination, items, resume=resume, user="ann")

    def at(self, moment: Any) -> None:
        self.clock.at = moment

    def until(self, plan: Any, *states: str) -> Any:
        """Tick until the plan has one of these states."""

        def there() -> bool:
            self.runner.tick()
            return self.plans.get(plan.id).state in states

        self.console.wait(there)
        return self.plans.get(plan.id)

    def sent(self, name: str) -> int:
        with self.console.commands._database.unit_of_work() as session:
            return len(store.page(session, store.Filter(names=(name,), user="ann"), 100))


@pytest.fixture
def mission(make_console, database, bus, clock, tle_of):
    """Mission with one station and a TLE of the previous day."""
    return Mission(make_console(), database, bus, clock, tle_of(1, clock.at))


def states(plan: Any) -> list[str]:
    return [item.state for item in items_of(plan)]


def test_a_plan_starts_at_its_pass_and_records_each_item(mission):
    """Nothing is sent before the pass or if the plan is not armed. In the pass the items run in order, with their times."""
    plan = mission.plan(mission.quick(STANDBY, name="a"), mission.quick(STATUS, name="b"))
    mission.at(plan.rise + timedelta(seconds=5))
    mission.runner.tick()
    assert mission.plans.get(plan.id).state == "draft"
    mission.at(plan.rise - timedelta(minutes=10))
    assert mission.plans.arm(plan.id, [], user="ann").state == "armed"
    assert mission.console.authority.holder() == "ann"
    mission.runner.tick()
    assert (mission.plans.get(plan.id).state, mission.sent("SET_MODE")) == ("armed", 0)
    mission.at(plan.rise + timedelta(seconds=5))
    done = mission.until(plan, "completed", "failed")
    assert (done.state, states(done)) == ("completed", ["done", "done"])
    assert (mission.sent("SET_MODE"), mission.sent("GET_STATUS")) == (1, 1)
    assert all(item.started and item.finished for item in items_of(done))
    with pytest.raises(Conflict, match="only a draft"):
        mission.plans.arm(plan.id, [], user="ann")


def test_loss_of_signal_pauses_and_the_next_pass_continues(mission):
    """A loss of signal pauses the plan. The next item is sent once, in the next pass over the station."""
    plan = mission.plan(mission.quick(STATUS, name="a"), mission.quick(STANDBY, name="b"), resume=True)
    mission.plans.arm(plan.id, [], user="ann")
    mission.at(plan.rise + timedelta(seconds=5))
    mission.runner.tick()  # starts the first item
    link, url = mission.console.link, mission.console.sensor.url
    mission.console.wait(lambda: mission.console.procedure_runs.newest(1)[0].state == "completed")
    link.close()
    mission.console.wait(lambda: not link.connected)
    paused = mission.until(plan, "paused")
    assert (paused.reason, mission.sent("SET_MODE")) == ("loss of signal", 0)
    mission.at(plan.set + timedelta(seconds=5))
    waiting = mission.until(plan, "waiting")
    assert waiting.rise > plan.set
    link.open_later(url)
    mission.console.wait(lambda: link.connected and link.hello is not None)
    mission.runner.tick()
    assert mission.plans.get(plan.id).state == "waiting"
    mission.at(waiting.rise + timedelta(seconds=5))
    done = mission.until(plan, "completed", "failed")
    assert (done.state, states(done), mission.sent("SET_MODE")) == ("completed", ["done", "done"], 1)


def test_a_pass_without_signal_is_missed(mission):
    """A plan without signal in its pass sends nothing and is missed with the reason."""
    plan = mission.plan(mission.quick(STATUS, name="a"))
    mission.plans.arm(plan.id, [], user="ann")
    mission.console.link.close()
    mission.console.wait(lambda: not mission.console.link.connected)
    mission.at(plan.set + timedelta(seconds=1))
    missed = mission.until(plan, "missed")
    assert (missed.reason, states(missed)) == ("no signal was acquired in the pass", ["waiting"])


@pytest.mark.parametrize("how", ["abort", "stop"])
def test_abort_and_stop_end_the_plan_and_its_procedure(mission, how):
    """ABORT and a stop end the plan and its current procedure. Later items are not sent."""
    plan = mission.plan(mission.quick(WAIT, STATUS, name="a"), mission.quick(STANDBY, name="b"))
    mission.plans.arm(plan.id, [], user="ann")
    mission.at(plan.rise + timedelta(seconds=5))
    mission.until(plan, "running")
    if how == "abort":
        mission.console.commands.abort(user="eve", source="form")
    else:
        mission.runner.stop(plan.id, user="eve")
    ended = mission.until(plan, "stopped")
    assert ended.reason == ("ABORT was sent" if how == "abort" else "stopped by eve")
    mission.console.run_ends(mission.console.procedure_runs.newest(1)[0])
    assert (states(ended), mission.sent("SET_MODE")) == (["stopped", "waiting"], 0)
    with pytest.raises(Conflict, match="not active"):
        mission.runner.stop(plan.id, user="eve")


@pytest.mark.parametrize("when", ["before", "during"])
def test_a_plan_whose_procedure_ended_at_abort_is_stopped(mission: Mission, monkeypatch: Any, when: str) -> None:
    """The plan and its item are stopped, also if ABORT ended the procedure before the plan was looked at, or meanwhile."""
    plan = mission.plan(mission.quick(WAIT, name="a"), mission.quick(STANDBY, name="b"))
    mission.plans.arm(plan.id, [], user="ann")
    mission.at(plan.rise + timedelta(seconds=5))
    mission.until(plan, "running")
    active = mission.plans.active

    def abort() -> Any:
        mission.console.commands.abort(user="eve", source="form")
        mission.console.wait(lambda: mission.console.procedure_runs.newest(1)[0].state == "aborted")
        return active()

    if when == "before":
        abort()
    else:  # after the number of ABORTs was read
        monkeypatch.setattr(mission.plans, "active", abort)
    mission.runner.tick()
    ended = mission.plans.get(plan.id)
    assert (ended.state, ended.reason, states(ended)) == ("stopped", "ABORT was sent", ["stopped", "waiting"])
    assert items_of(ended)[0].detail == "ABORT by eve"


def test_an_item_that_starts_at_abort_sends_nothing(mission: Mission, monkeypatch: Any) -> None:
    """If ABORT is sent while an item starts, its procedure sends no command, and the plan is stopped."""
    plan, runs = mission.plan(mission.quick(STATUS, WAIT, name="a")), mission.console.procedure_runs
    mission.plans.arm(plan.id, [], user="ann")
    mission.at(plan.rise + timedelta(seconds=5))
    begin = runs.begin

    def begin_after_abort(*arguments: Any, **options: Any) -> Any:
        mission.console.commands.abort(user="eve", source="form")
        mission.console.wait(lambda: any("ABORTED" in event.text for event in mission.bus.after(0, 1000)))
        row = begin(*arguments, **options)
        mission.console.wait(lambda: runs.get(row.id).entries and runs.get(row.id).entries[-1]["state"] != "sending")
        return row

    monkeypatch.setattr(runs, "begin", begin_after_abort)
    mission.runner.tick()
    ended = mission.plans.get(plan.id)
    assert (ended.state, states(ended)) == ("stopped", ["stopped"])
    assert "ABORT was requested before this command was sent" in runs.newest(1)[0].entries[0]["detail"]


def test_after_a_restart_an_item_in_progress_is_unknown_and_an_armed_plan_stays(
    mission, make_console, database, bus, clock, tle_of
):
    """After a restart, a running plan is stopped with its item unknown, and nothing is sent again. An armed plan is still
    armed."""
    later = mission.plan(mission.quick(STANDBY, name="b"), name="later")
    mission.at(later.set + timedelta(minutes=5))
    second = mission.plan(mission.quick(WAIT, STATUS, name="a"), name="second")
    third = mission.plan(mission.quick(STANDBY, name="c"), name="third")
    mission.plans.change(third.id, rise=second.set + timedelta(hours=1), set=second.set + timedelta(hours=2))
    for plan in (second, third):
        mission.plans.arm(plan.id, [], user="ann")
    mission.at(second.rise + timedelta(seconds=5))
    mission.until(second, "running")
    restarted = Mission(make_console(), database, bus, clock, "")
    restarted.runner.start()
    stopped = restarted.plans.get(second.id)
    assert (stopped.state, states(stopped), "restarted" in stopped.reason) == ("stopped", ["unknown"], True)
    assert restarted.plans.get(third.id).state == "armed"
    restarted.runner.tick()
    assert restarted.sent("GET_STATUS") == 0


def test_a_plan_is_armed_only_if_it_fits_and_its_user_may(mission):
    """A plan that is too long, overlaps another, is in the past, or whose user lacks permission, confirmation or authority
    is not armed, with the reason."""
    item = mission.quick(STATUS, name="a")
    long = mission.plan(*[item] * 40, name="long")
    with pytest.raises(Conflict, match="cannot be armed") as caught:
        mission.plans.arm(long.id, [], user="ann")
    assert "The items need 1200 s" in caught.value.got
    plan, other = mission.plan(item), mission.plan(item, name="other")
    mission.plans.arm(other.id, [], user="ann")
    assert "overlaps the armed plan other" in mission.plans.problems(plan)[0]
    mission.runner.stop(other.id, user="ann")
    erase = mission.plan(mission.quick(("command", "ERASE_BANK bank=C"), name="e"), name="erase")
    with pytest.raises(BadInput, match="need confirmation"):
        mission.plans.arm(erase.id, [], user="ann")
    mission.console.refused.add("bob")
    with pytest.raises(NotPermitted):
        mission.plans.arm(plan.id, [], user="bob")
    with pytest.raises(Conflict, match="command authority is held by ann"):
        mission.plans.arm(plan.id, [], user="eve")
    mission.at(plan.set + timedelta(seconds=1))
    assert "The pass is over" in mission.plans.problems(plan)[0]
    with pytest.raises(BadInput, match="not in view"):
        mission.plans.create("x", plan.station_id, plan.rise - timedelta(minutes=20), [item], resume=False, user="ann")
    mission.plans.delete(plan.id)
    with pytest.raises(Conflict, match="only a draft can be deleted"):
        mission.plans.delete(other.id)


def test_lost_authority_fails_the_plan_before_anything_is_sent(mission):
    """If another user broke the authority, the plan fails and sends nothing."""
    plan = mission.plan(mission.quick(STANDBY, name="a"))
    mission.plans.arm(plan.id, [], user="ann")
    mission.console.authority.break_("eve", "urgent")
    mission.at(plan.rise + timedelta(seconds=5))
    failed = mission.until(plan, "failed")
    assert "command authority is held by eve" in failed.reason
    assert mission.sent("SET_MODE") == 0


ERASE = """# Erase bank C

## look: Is it free?

```question
Is bank C unused?
yes: erase
no: end
```

## erase: Erase it

```command
ERASE_BANK bank=C
```

## gone: No fault

```check
housekeeping.sensor_temperature_c > 900
within: 60 s
else: end
```

## never: Not reached

```command
GET_STATUS
```
"""


def test_a_procedure_in_a_plan_asks_sends_and_waits_for_the_signal(mission):
    """A procedure in a plan waits for an answer, sends the command that was confirmed at arming, and evaluates no check
    while the signal is lost."""
    plan = mission.plan(mission.procedure(ERASE), resume=True)
    with pytest.raises(BadInput, match="need confirmation"):
        mission.plans.arm(plan.id, [], user="ann")
    mission.plans.arm(plan.id, ["ERASE_BANK"], user="ann")
    mission.at(plan.rise + timedelta(seconds=5))
    runs = mission.console.procedure_runs

    def is_waiting() -> bool:
        mission.runner.tick()
        return "waits for an operator" in items_of(mission.plans.get(plan.id))[0].detail

    mission.console.wait(is_waiting)
    run = runs.newest(1)[0]
    assert (run.current, mission.sent("ERASE_BANK")) == ("look", 0)
    runs.run_step(run.id, "look", user="ann", answer="yes")
    mission.console.wait(lambda: runs.get(run.id).current == "gone" and runs.get(run.id).entries[-1]["step"] == "gone")
    link, url = mission.console.link, mission.console.sensor.url
    link.close()
    mission.console.wait(lambda: not link.connected)
    assert mission.until(plan, "paused").reason == "loss of signal"
    mission.at(plan.set + timedelta(seconds=5))
    waiting = mission.until(plan, "waiting")
    runs.tick()
    assert (runs.get(run.id).state, runs.get(run.id).current) == ("running", "gone")
    link.open_later(url)
    mission.console.wait(lambda: link.connected and link.hello is not None)
    mission.at(waiting.rise + timedelta(seconds=5))
    assert mission.until(plan, "running").state == "running"
    assert runs.get(run.id).current == "gone"
    mission.at(waiting.rise + timedelta(seconds=100))
    done = mission.until(plan, "completed", "failed")
    assert (done.state, runs.get(run.id).state) == ("completed", "completed")
    assert (mission.sent("ERASE_BANK"), mission.sent("GET_STATUS")) == (1, 0)


def test_a_plan_whose_procedure_was_replaced_is_not_armed(mission):
    """A plan is not armed if its procedure was changed, or deleted and its id has another procedure. The id of a deleted
    procedure is not used again."""
    changed, deleted = mission.quick(STATUS, name="Look"), mission.quick(STATUS, name="See")
    plans = [mission.plan(changed), mission.plan(deleted)]
    procedures = mission.console.procedures
    text = procedures.get(changed.procedure_id).text
    procedures.change(changed.procedure_id, text.replace("GET_STATUS", "STOP_CYCLE"), sha256=hash_of(text), user="bob")
    procedures.delete(deleted.procedure_id)
    assert mission.quick(STANDBY, name="Other").procedure_id > deleted.procedure_id
    advice = "Review the present procedure, create a new plan, and delete this draft."
    for plan, name in zip(plans, ("Look", "See"), strict=True):
        changed_text = f"Procedure {name} was changed or deleted after the plan was created."
        assert mission.plans.problems(plan) == [f"{changed_text} {advice}"]
    with pytest.raises(Conflict, match="cannot be armed"):
        mission.plans.arm(plans[0].id, [], user="ann")


def test_a_draft_of_an_earlier_version_states_why_it_cannot_be_armed(mission: Mission) -> None:
    """Earlier versions stored no hash, so that it is not known whether the procedure was changed."""
    plan = mission.plan(mission.quick(STATUS, name="Look"))
    plan = mission.plans.change(plan.id, [replace(item, reviewed_sha256="") for item in items_of(plan)])
    assert mission.plans.problems(plan) == [
        "Procedure Look was added by an earlier version of GSS, which did not store its hash. "
        "Review the present procedure, create a new plan, and delete this draft."
    ]


def test_a_procedure_changed_after_arming_is_not_run(mission):
    """If a procedure was changed after arming, the plan fails, and neither version is sent."""
    item = mission.quick(STATUS, name="Look")
    plan = mission.plan(item)
    mission.plans.arm(plan.id, [], user="ann")
    text = mission.console.procedures.get(item.procedure_id).text
    changed = text.replace("GET_STATUS", "STOP_CYCLE")
    mission.console.procedures.change(item.procedure_id, changed, sha256=hash_of(text), user="bob")
    mission.at(plan.rise + timedelta(seconds=5))
    failed = mission.until(plan, "failed", "completed")
    assert (failed.state, "was changed or deleted after the plan was created" in failed.reason) == ("failed", True)
    assert not any(mission.sent(name) for name in ("GET_STATUS", "STOP_CYCLE"))


def test_a_procedure_with_an_unknown_command_cannot_be_planned(mission):
    """A plan with such a procedure is rejected with line and command."""
    with pytest.raises(BadInput, match=r"Line 5.*NO_SUCH"):
        mission.plan(mission.procedure("# Wrong\n\n## a: A\n```command\nNO_SUCH\n```\n"))


def test_after_a_restart_the_procedure_of_a_plan_is_interrupted_and_a_person_resumes_it(
    mission, make_console, database, bus, clock
):
    """After a restart the run is interrupted and does not block other procedures. When a user resumes it, it continues in
    its step and sends nothing twice."""
    text = "# Look\n\n## ask: Ask\n\n```command\nGET_STATUS\n```\n\n## pause: Pause\n\n```wait\n1 h\n```\n"
    plan = mission.plan(mission.procedure(text))
    mission.plans.arm(plan.id, [], user="ann")
    mission.at(plan.rise + timedelta(seconds=5))
    mission.until(plan, "running")
    run = mission.console.procedure_runs.newest(1)[0]
    mission.console.wait(lambda: mission.console.procedure_runs.get(run.id).current == "pause")
    restarted = Mission(make_console(), database, bus, clock, "")
    restarted.runner.start()
    runs, stopped = restarted.console.procedure_runs, restarted.plans.get(plan.id)
    interrupted = runs.get(run.id)
    assert (stopped.state, interrupted.state, interrupted.current, is_intact(interrupted)) == (
        "stopped",
        "interrupted",
        "pause",
        True,
    )
    assert "resume it" in items_of(stopped)[0].detail
    with pytest.raises(Conflict, match="has ended"):
        runs.run_step(run.id, "pause", user="ann")
    other = runs.begin(restarted.console.procedures.create("# B\n\n## a: A\n", user="ann").id, user="ann")
    with pytest.raises(Conflict, match="Another procedure"):
        runs.resume(run.id, user="ann")
    runs.stop(other.id, "", user="ann")
    assert runs.resume(run.id, user="ann").current == "pause"
    restarted.console.wait(lambda: runs.get(run.id).current == "pause")
    runs.skip(run.id, "pause", "long enough", user="ann")
    done = runs.get(run.id)
    assert (done.state, is_intact(done), restarted.sent("GET_STATUS")) == ("completed", True, 1)
    with pytest.raises(Conflict, match="Only an interrupted run"):
        runs.resume(run.id, user="ann")


@pytest.mark.parametrize("known", [True, False], ids=["after the start", "before the start"])
def test_an_item_whose_start_could_not_be_stored_is_not_skipped(
    mission: Mission, monkeypatch: pytest.MonkeyPatch, known: bool
) -> None:
    """If the store fails after an item was started, the item is followed and the next one waits. If it fails before, it is not
    known whether the item was started, and the plan stops."""
    plan = mission.plan(mission.quick(WAIT, name="a"), mission.quick(STANDBY, name="b"))
    mission.plans.arm(plan.id, [], user="ann")
    mission.at(plan.rise + timedelta(seconds=5))
    change = mission.plans.change

    def fails(plan_id: int, items: Any = None, **values: Any) -> Any:
        if items is not None and any(item.state == ("running" if known else "failed") for item in items):
            raise StoreDown("the database is locked")
        return change(plan_id, items, **values)

    with monkeypatch.context() as patch:
        patch.setattr(mission.plans, "change", fails)
        if not known:
            patch.setattr(mission.console.procedure_runs, "begin", _raise_store_down)
        with pytest.raises(StoreDown):
            mission.runner.tick()
    mission.runner.tick()
    if known:
        assert states(mission.plans.get(plan.id)) == ["running", "waiting"]
        stopped = mission.runner.stop(plan.id, user="ann")
        assert states(stopped) == ["stopped", "waiting"]
        assert mission.console.procedure_runs.newest(1)[0].state == "stopped"
    else:
        stopped = mission.plans.get(plan.id)
        assert (stopped.state, states(stopped)) == ("stopped", ["unknown", "waiting"])
        assert "not known whether an item was started" in stopped.reason
    assert mission.sent("SET_MODE") == 0


def _raise_store_down(*_: Any, **__: Any) -> None:
    raise StoreDown("the database is locked")


def test_a_plan_that_continues_does_not_take_the_pass_of_another_plan(mission: Mission) -> None:
    """The plan waits for the next pass over its station that has no other plan."""
    first = mission.plan(mission.quick(STATUS, WAIT, name="a"), resume=True)
    mission.plans.arm(first.id, [], user="ann")
    taken, free = [p for p in mission.table.upcoming(3).passes if p.at.rise > first.set][:2]
    item = mission.quick(STANDBY, name="b")
    other = mission.plans.create("o", taken.station.id, taken.at.culmination, [item], resume=False, user="ann")
    mission.plans.arm(other.id, [], user="ann")
    mission.at(first.rise + timedelta(seconds=5))
    mission.runner.tick()
    mission.at(first.set + timedelta(seconds=5))
    mission.runner.tick()
    waiting = mission.plans.get(first.id)
    assert (waiting.state, waiting.rise) == ("waiting", free.at.rise)


def test_an_item_that_was_done_before_the_signal_was_lost_is_shown_as_done(mission: Mission) -> None:
    """The procedure completes, and the signal is lost before the plan looks at it again and does not return in this pass."""
    plan = mission.plan(mission.quick(STATUS, name="a"))
    mission.plans.arm(plan.id, [], user="ann")
    mission.at(plan.rise + timedelta(seconds=5))
    mission.runner.tick()
    mission.console.wait(lambda: mission.console.procedure_runs.newest(1)[0].state == "completed")
    mission.console.link.close()
    mission.console.wait(lambda: not mission.console.link.connected)
    mission.runner.tick()
    mission.at(plan.set + timedelta(seconds=5))
    mission.runner.tick()
    ended = mission.plans.get(plan.id)
    assert (ended.state, states(ended)) == ("completed", ["done"])

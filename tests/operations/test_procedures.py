"""Procedures: checked before they start, run step by step on a simulated sensor, recorded and frozen."""

from __future__ import annotations

import hashlib
import json
from datetime import timedelta
from typing import Any

import pytest

from gss.domain.errors import BadInput, Conflict, NotPermitted
from gss.operations.procedures.document import read_procedure
from gss.operations.procedures.procedures import hash_of
from gss.operations.procedures.run_record import StepEntry, entries_of, is_intact, record_bytes
from gss.store.commands import Filter

pytestmark = pytest.mark.timeout(180)


def fence(kind: str, *lines: str) -> str:
    """Return a fenced block."""
    return "\n".join([f"```{kind}", *lines, "```", ""])


def procedure(*steps: tuple[str, str], title: str = "Test") -> str:
    """Return a procedure with these (name, content) steps."""
    return f"# {title}\n\nIntroduction.\n\n" + "\n".join(
        f"## {name}: The {name} step\n\n{body}" for name, body in steps
    )


GOOD = procedure(
    ("note", "Read this."),
    ("cool", fence("check", "housekeeping.sensor_temperature_c < 200", "within: 60 s", "else: pause")),
    ("status", fence("command", "GET_STATUS")),
    ("dark", fence("question", "Is the sky dark?", "yes: way", "no: end")),
    ("way", fence("branch", "if housekeeping.sensor_temperature_c > 200: pause", "else: second")),
    ("pause", fence("wait", "30 s")),
    ("second", fence("hold", "The unit may be commanded.")),
    ("signed", fence("sign", "Complete.")),
)


def begin(console: Any, text: str, **how: Any) -> Any:
    """Store a procedure and start it."""
    row = console.procedures.create(text, user="ann")
    return console.procedure_runs.begin(row.id, user="ann", **how)


def states(console: Any, run: Any) -> list[tuple[str, str]]:
    """Return (step, state) of every entry."""
    return [(e.step, e.state) for e in entries_of(console.procedure_runs.get(run.id))]


def step(console: Any, run: Any, name: str, user: str = "ann", **how: Any) -> Any:
    """Run a step and wait until it has ended."""
    console.procedure_runs.run_step(run.id, name, user=user, **how)
    console.wait(lambda: states(console, run)[-1][1] == "failed" or console.procedure_runs.get(run.id).current != name)
    return console.procedure_runs.get(run.id)


def sent(console: Any) -> list[str]:
    """Return the commands that procedures sent."""
    return [row.name for row in console.history.page(Filter(source="procedure"), 20)]


# --- reading ------------------------------------------------------------------------------------------------------


def test_a_procedure_is_read_with_its_texts_and_actions() -> None:
    """A procedure is read with title, introduction, and the text, action, options and targets of each step."""
    document = read_procedure(GOOD)
    assert (document.title, document.introduction, document.mistakes) == ("Test", "Introduction.", ())
    assert [(s.id, s.kind) for s in document.steps] == [
        ("note", "text"),
        ("cool", "check"),
        ("status", "command"),
        ("dark", "question"),
        ("way", "branch"),
        ("pause", "wait"),
        ("second", "hold"),
        ("signed", "sign"),
    ]
    cool = document.step("cool")
    assert (cool.words, cool.seconds, cool.target("else")) == ("housekeeping.sensor_temperature_c < 200", 60.0, "pause")
    assert document.step("note").text == "Read this."
    assert document.after(document.step("signed"), "next") is None


@pytest.mark.parametrize(
    ("text", "line", "words"),
    [
        ("## a: b\n", 1, "no title"),
        ("# T\n", 1, "has 0 steps"),
        ("# T\n## Without name\n", 2, "is not a step"),
        (procedure(("end", "x")), 5, "cannot be named end"),
        (procedure(("a", fence("command", "NO_SUCH"))), 8, "unknown command"),
        (procedure(("a", fence("command", "ABORT"))), 8, "ABORT cannot be a step"),
        (procedure(("a", fence("command", "TAKE_IMAGE slot=4000"))), 8, "slot"),
        (procedure(("a", fence("command", "TAKE_IMAGE slot=x"))), 8, "not a number"),
        (procedure(("a", fence("command", "TAKE_IMAGE depth=3"))), 8, "has no argument depth"),
        (procedure(("a", fence("command", "TAKE_IMAGE slot"))), 8, "argument=value"),
        (procedure(("a", fence("check", "housekeeping.nothing > 1"))), 8, "unknown telemetry field"),
        (procedure(("a", fence("check", "housekeeping.supply_3v3_v + 1"))), 8, "not a condition"),
        (procedure(("a", fence("check", "1 <"))), 8, "position"),
        (procedure(("a", fence("check", "1 < 2", "then: b"))), 8, "unknown option"),
        (procedure(("a", fence("check", "1 < 2", "else: b"))), 8, "There is no step b"),
        (procedure(("a", fence("wait", "soon"))), 8, "duration"),
        (procedure(("a", fence("question", "Dark?"))), 8, "no answers"),
        (procedure(("a", fence("branch", "if 1 < 2: end"))), 8, "does not end with an else line"),
        (procedure(("a", fence("check"))), 8, "block is empty"),
        (procedure(("a", "x"), ("a", "y")), 8, "used twice"),
        (procedure(("a", fence("question", "Dark?", "no: end")), ("b", "x")), 12, "b cannot be reached"),
        (procedure(("a", fence("wait", "1 s") + fence("wait", "1 s"))), 10, "one action"),
    ],
)
def test_a_mistake_is_reported_with_its_line(console: Any, text: str, line: int, words: str) -> None:
    """Each error in a procedure is reported with its line."""
    matches = [m for m in console.procedures.check(text).mistakes if words in m.text]
    assert matches, console.procedures.check(text).mistakes
    assert matches[0].line == line, matches


def test_a_procedure_with_mistakes_is_stored_and_cannot_start(console: Any) -> None:
    """A procedure with errors is stored. Starting it is rejected with the first error."""
    row = console.procedures.create(procedure(("a", fence("command", "NO_SUCH"))), user="ann")
    with pytest.raises(BadInput, match=r"cannot start\. Line 8: unknown command"):
        console.procedure_runs.begin(row.id, user="ann")
    with pytest.raises(Conflict, match="title exists"):
        console.procedures.create(procedure(("a", "x")), user="ann")
    text, sha256 = procedure(("a", "x"), title="Other"), hash_of(row.text)
    changed = console.procedures.change(row.id, text, sha256=sha256, user="bob")
    assert (changed.name, changed.author) == ("Other", "bob")
    with pytest.raises(Conflict, match="has changed since you opened it; expected the text of bob"):
        console.procedures.change(row.id, text, sha256=sha256, user="ann")


# --- running ------------------------------------------------------------------------------------------------------


def test_a_procedure_is_run_step_by_step_and_its_record_is_frozen(console: Any) -> None:
    """The record has the values of checks, the command, the answer and the users, and its hash reveals a change."""
    run = begin(console, GOOD)
    assert console.procedure_runs.get(run.id).current == "note"
    for name, how in (("note", {}), ("cool", {}), ("status", {}), ("dark", {"answer": "yes"}), ("way", {})):
        step(console, run, name, **how)
    with pytest.raises(Conflict, match="second person"):
        console.procedure_runs.run_step(run.id, "second", user="ann")
    with pytest.raises(Conflict, match="not the current step"):
        console.procedure_runs.run_step(run.id, "signed", user="ann")
    step(console, run, "second", user="bob")
    done = step(console, run, "signed", note="all well")
    assert (done.state, done.current, {s for _, s in states(console, run)}) == ("completed", "", {"done"})
    record = json.loads(record_bytes(done))
    assert done.sha256 == hashlib.sha256(record_bytes(done)).hexdigest()
    entries = {e["step"]: e for e in record["entries"]}
    assert entries["cool"]["values"].keys() == {"housekeeping.sensor_temperature_c"}
    assert console.commands.get(entries["status"]["command_id"]).source == "procedure"
    assert (entries["dark"]["detail"], entries["second"]["by"], entries["signed"]["note"]) == ("yes", "bob", "all well")
    assert "pause" not in entries
    assert is_intact(done)
    done.entries = [*done.entries[:-1], done.entries[-1] | {"by": "mallory"}]
    assert not is_intact(done)


def test_an_automatic_run_stops_where_a_person_is_needed(console: Any) -> None:
    """Commands, branches and waits run automatically, and a question waits for a user."""
    text = procedure(
        ("status", fence("command", "GET_STATUS")),
        ("way", fence("branch", "if housekeeping.sensor_temperature_c < 200: pause", "else: end")),
        ("pause", fence("wait", "30 s")),
        ("dark", fence("question", "Dark?", "yes: end", "no: end")),
    )
    run = begin(console, text, automatic=True)
    console.wait(lambda: console.procedure_runs.get(run.id).current == "dark")
    assert step(console, run, "dark", answer="no").state == "completed"


def test_a_check_that_is_not_met_or_unknown_fails_and_waits_for_a_person(console: Any) -> None:
    """A check that is not met or unknown fails. A user can run it again, or skip it with a reason."""
    unknown = "housekeeping.sensor_temperature_c / 0 > 1"
    run = begin(
        console,
        procedure(("hot", fence("check", "housekeeping.sensor_temperature_c > 500")), ("odd", fence("check", unknown))),
    )
    step(console, run, "hot")
    step(console, run, "hot")
    assert states(console, run) == [("hot", "failed"), ("hot", "failed")]
    with pytest.raises(BadInput, match="needs a reason"):
        console.procedure_runs.skip(run.id, "hot", " ", user="ann")
    console.procedure_runs.skip(run.id, "hot", "measured by hand", user="ann")
    step(console, run, "odd")
    assert entries_of(console.procedure_runs.get(run.id))[-1].detail == "The check is unknown: division by zero."
    ended = console.procedure_runs.stop(run.id, "no time", user="bob")
    assert (ended.state, ended.reason) == ("stopped", "stopped by bob: no time")


def test_only_a_person_with_command_authority_sends(console: Any) -> None:
    """A command of a user without authority or permission is recorded as failed and is not sent."""
    run = begin(console, procedure(("status", fence("command", "GET_STATUS"))))
    console.authority.take("bob")
    with pytest.raises(Conflict, match="held by bob"):
        console.procedure_runs.run_step(run.id, "status", user="ann")
    console.refused.add("eve")
    with pytest.raises(NotPermitted):
        console.procedure_runs.run_step(run.id, "status", user="eve")
    assert states(console, run) == [("status", "failed"), ("status", "failed")]
    assert step(console, run, "status", user="bob").state == "completed"
    assert sent(console) == ["GET_STATUS"]


def test_abort_ends_a_procedure(console: Any) -> None:
    """ABORT ends the procedure and its current step, and no later step can be run."""
    run = begin(console, procedure(("pause", fence("wait", "1 h")), ("status", fence("command", "GET_STATUS"))))
    console.procedure_runs.run_step(run.id, "pause", user="ann")
    console.commands.abort(user="bob", source="header")
    console.wait(lambda: console.procedure_runs.get(run.id).finished is not None)
    ended = console.procedure_runs.get(run.id)
    assert (ended.state, ended.reason, states(console, run)) == ("aborted", "ABORT by bob", [("pause", "failed")])
    with pytest.raises(Conflict, match="has ended"):
        console.procedure_runs.run_step(run.id, "status", user="ann")


def test_one_procedure_runs_at_a_time(console: Any) -> None:
    """A second procedure is rejected with the number of the running one."""
    run = begin(console, procedure(("a", "x")))
    with pytest.raises(Conflict, match=f"got run {run.id}"):
        begin(console, procedure(("a", "x"), title="Second"))


def test_a_run_continues_after_a_restart_and_sends_nothing_twice(console: Any, make_console: Any) -> None:
    """After a restart a wait continues, and a completed command is not sent again."""
    text = procedure(("status", fence("command", "GET_STATUS")), ("pause", fence("wait", "30 s")), ("last", "x"))
    run = begin(console, text)
    step(console, run, "status")
    console.procedure_runs.run_step(run.id, "pause", user="ann")
    restarted = make_console(sensor=console.sensor)
    assert states(restarted, run) == [("status", "done"), ("pause", "running")]
    restarted.wait(lambda: restarted.procedure_runs.get(run.id).current == "last")
    assert sent(restarted) == ["GET_STATUS"]


def test_a_server_that_dies_before_queueing_leaves_a_step_that_was_not_sent(console: Any, make_console: Any) -> None:
    """A step that was stored as sending without a command has failed after a restart, and a user can run it again."""
    run = begin(console, procedure(("status", fence("command", "GET_STATUS"))))
    recorder = console.procedure_runs._record
    recorder.add(run.id, StepEntry("status", "t", "command", "sending", "ann", console.link._now().isoformat()))
    restarted = make_console(sensor=console.sensor)
    [entry] = entries_of(restarted.procedure_runs.get(run.id))
    assert (entry.state, "was not sent" in entry.detail) == ("failed", True)
    assert step(restarted, run, "status").state == "completed"


# --- automatic runs -----------------------------------------------------------------------------------------------


def commands(*lines: str, title: str = "Test") -> str:
    """Return a procedure with a step for each command, named a, b, c …"""
    return procedure(*((chr(97 + k), fence("command", line)) for k, line in enumerate(lines)), title=title)


def test_an_automatic_start_needs_permission_authority_and_line(console: Any) -> None:
    """An automatic run does not start if its user lacks a permission or the authority, or if the line is down."""
    row = console.procedures.create(commands("GET_STATUS", "ERASE_BANK bank=C"), user="ann")

    def start(user: str) -> Any:
        return console.procedure_runs.begin(row.id, user=user, automatic=True, confirmed=["ERASE_BANK"])

    console.refused.add("eve")
    with pytest.raises(NotPermitted):
        start("eve")
    console.authority.take("bob")
    with pytest.raises(Conflict, match="held by bob"):
        start("ann")
    console.link.close()
    console.wait(lambda: not console.link.connected)
    with pytest.raises(Conflict, match="line is down"):
        start("bob")
    assert (console.procedure_runs.newest(5), sent(console)) == ([], [])


def test_names_confirmed_at_the_start_apply_until_a_step_fails(console: Any) -> None:
    """A confirmed hazardous command is sent automatically. After a failed step, it must be confirmed again."""
    first = begin(console, commands("POWER rail=imager state=off"), automatic=True, confirmed=["POWER"])
    assert console.run_ends(first).state == "completed"
    text = commands("FIND_CENTROIDS", "POWER rail=imager state=off", title="Second")
    run = begin(console, text, automatic=True, confirmed=["POWER"])
    console.wait(lambda: states(console, run) == [("a", "failed")])
    console.procedure_runs.skip(run.id, "a", "not needed", user="ann")
    console.procedure_runs.set_automatic(run.id, True, user="ann")
    console.procedure_runs.tick()
    assert (console.procedure_runs.state(run.id)[1], sent(console).count("POWER")) == ("b", 1)
    with pytest.raises(BadInput):
        console.procedure_runs.run_step(run.id, "b", user="ann")
    console.procedure_runs.run_step(run.id, "b", user="ann", confirm="POWER")
    assert console.run_ends(run).state == "completed"


@pytest.mark.parametrize("how", ["line", "stop"])
def test_a_queued_command_is_withdrawn_if_the_line_is_lost_or_the_run_is_stopped(console: Any, how: str) -> None:
    """A command that is queued when the line is lost or the run is stopped is not sent in the next contact. The loss of the
    line ends automatic execution."""
    image = console.send("TAKE_IMAGE", exposure_ms=2000)
    console.wait(lambda: console.commands.get(image.id).result == "started")
    run = begin(console, commands("SET_EXPOSURE exposure_ms=5", "GET_STATUS"), automatic=True)
    console.wait(lambda: sent(console) == ["SET_EXPOSURE"])
    if how == "line":
        console.sensor.cut = True
        console.wait(lambda: not console.procedure_runs.get(run.id).automatic)
        console.wait(lambda: states(console, run) == [("a", "failed")])
        assert console.procedure_runs.get(run.id).state == "running"
    else:
        assert console.procedure_runs.stop(run.id, "", user="bob").state == "stopped"
    [row] = console.history.page(Filter(run_id=run.id), 20)
    assert (row.name, row.result) == ("SET_EXPOSURE", "withdrawn")


def test_a_lost_line_pauses_an_automatic_run_until_an_operator_continues_it(console: Any) -> None:
    """After the loss of the line no step starts, also when the line is open again, until a user continues the run."""
    run = begin(console, procedure(("a", fence("wait", "30 s")), ("b", fence("command", "GET_STATUS"))), automatic=True)
    console.wait(lambda: states(console, run) == [("a", "running")])
    url = console.sensor.url
    console.link.close()
    console.wait(lambda: not console.procedure_runs.get(run.id).automatic)
    with pytest.raises(Conflict, match="line is down"):
        console.procedure_runs.set_automatic(run.id, True, user="ann")
    console.link.open_later(url)
    console.wait(lambda: console.link.connected and console.link.hello is not None)
    console.wait(lambda: console.procedure_runs.get(run.id).current == "b")
    assert sent(console) == []
    assert any("paused at step a: the line is down" in event.text for event in console.bus.after(0, 1000))
    console.procedure_runs.set_automatic(run.id, True, user="ann")
    assert console.run_ends(run).state == "completed"


def test_a_check_with_a_time_limit_ignores_values_from_before_the_last_command(
    console: Any, clock: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A value received before the last command ended does not satisfy a check, because it can describe the earlier state."""
    check = fence("check", "housekeeping.sensor_temperature_c < 200", "within: 10 min")
    run = begin(console, procedure(("a", fence("command", "GET_STATUS")), ("b", check)))
    step(console, run, "a")
    with monkeypatch.context() as patch:
        before = clock() - timedelta(seconds=100), console.telemetry.newest_values("housekeeping")[1]
        patch.setattr(console.telemetry, "newest_values", lambda _packet: before)
        console.procedure_runs.run_step(run.id, "b", user="ann")
        console.procedure_runs.tick()
        assert states(console, run)[-1] == ("b", "running")
    assert console.run_ends(run).state == "completed"

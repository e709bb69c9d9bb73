"""Commands during and after execution: authority, hazards, late reports, retries, restarts and the command history."""

from __future__ import annotations

import csv
import io
import json
from datetime import timedelta
from typing import Any

import pytest

from gss.device.exchange_session import ExchangeSession
from gss.device.session_events import Stage
from gss.device.simulator.machine import Identity
from gss.domain.errors import BadInput, Conflict, NotPermitted, StoreDown
from gss.instruments.dictionary.read_dictionary import load_dictionary
from gss.instruments.marked_yaml import parse_yaml
from gss.instruments.roles import read_roles
from gss.operations.commanding.command_checks import REMEMBERED_IDS
from gss.operations.commanding.command_history import Filter
from gss.store.models import Command

pytestmark = pytest.mark.timeout(120)


@pytest.fixture
def console(make_console):
    """Operator console whose sensor has identified itself."""
    return make_console()


@pytest.fixture
def sent_aborts(console, monkeypatch) -> list[tuple[str, str]]:
    """Users and sources of ABORTs, which are not sent."""
    sent: list[tuple[str, str]] = []

    def issue(user: str, source: str) -> None:
        sent.append((user, source))
        raise StoreDown("ABORT is not sent in this test")

    monkeypatch.setattr(console.commands._aborts, "issue", issue)
    return sent


def stages(row: Any) -> list[str]:
    return [stage.stage for stage in row.stages]


# --- authority and hazards ---------------------------------------------------------------------------------------------


def test_a_command_without_authority_is_rejected_with_the_holders_name(console):
    """The first command takes authority. A command of another user is rejected and not stored, but ABORT of any user is
    sent."""
    assert console.end(console.send("GET_STATUS")).result == "completed"
    assert console.authority.holder() == "ann"
    before = len(console.history.page(Filter(), 100))
    with pytest.raises(Conflict, match="held by ann"):
        console.send("GET_STATUS", user="bob")
    assert len(console.history.page(Filter(), 100)) == before
    assert any("held by ann" in p for p in console.commands.check("GET_STATUS", {}, user="bob").problems)
    assert console.end(console.commands.abort(user="bob", source="abort").row(20)).result == "completed"
    console.authority.break_("bob", "pass begins")
    assert console.end(console.send("GET_STATUS", user="bob")).result == "completed"


def test_only_the_arguments_of_abort_are_abort(console, sent_aborts):
    """If ABORT shares a command with other operations, the command is ABORT only with ABORT's arguments: other arguments need
    their permission, and are sent as they are."""
    text = "operations: {abort: {command: SET_MODE, fixed: {mode: lost_in_space}}, set_mode: {command: SET_MODE}}"
    console.link.roles = read_roles(parse_yaml("operations.yaml", text.encode()), load_dictionary())
    console.refused.add("ann")
    with pytest.raises(NotPermitted):
        console.send("SET_MODE", mode="tracking")
    console.refused.clear()
    assert console.send("SET_MODE", mode="tracking").name == "SET_MODE"
    assert sent_aborts == []
    with pytest.raises(StoreDown):
        console.send("SET_MODE")
    assert sent_aborts == [("ann", "form")]


def test_a_rejected_command_does_not_take_authority(console):
    """A command rejected for invalid arguments or a missing confirmation does not take authority."""
    for name, arguments in (("SET_EXPOSURE", {"exposure_ms": 99_999}), ("RESET", {})):
        with pytest.raises(BadInput):
            console.send(name, **arguments)
    assert console.authority.holder() is None


def test_the_argument_value_decides_what_must_be_confirmed(console):
    """The hazard depends on the argument: POWER on is harmless, and POWER off needs a confirmation."""
    assert console.end(console.send("POWER", rail="imager", state="on")).result == "completed"
    with pytest.raises(BadInput, match="POWER was not confirmed"):
        console.send("POWER", rail="imager", state="off")
    check = console.commands.check("POWER", {"rail": "imager", "state": "off"}, user="ann")
    assert (check.risk.hazard, check.risk.name, check.problems) == ("warning", "POWER", ())
    assert console.commands.check("POWER", {"state": "on"}, user="ann").risk.hazard == "none"
    assert console.send("POWER", rail="imager", state="off", confirm="yes").name == "POWER"


def test_schedule_is_as_hazardous_as_its_inner_command(console):
    """SCHEDULE has the hazard of its inner command, whose name confirms it. The name SCHEDULE does not."""
    dictionary = console.link.dictionary
    erase = dictionary.command("ERASE_BANK")
    order = {"at_s": 1e6, "command_code": erase.code, "length": 1, "payload": "02" + "00" * 63}
    check = console.commands.check("SCHEDULE", order, user="ann")
    assert (check.risk.hazard, check.risk.name) == ("critical", "ERASE_BANK")
    for confirm in ("", "yes", "SCHEDULE"):
        with pytest.raises(BadInput, match="ERASE_BANK is critical"):
            console.send("SCHEDULE", confirm=confirm, **order)
    harmless = order | {"command_code": dictionary.command("GET_STATUS").code, "length": 0}
    assert console.commands.check("SCHEDULE", harmless, user="ann").risk.hazard == "watch"


def test_simulator_commands_are_hidden_from_a_real_unit(make_console):
    """Simulator commands are neither listed for nor sent to a device that identifies itself as real."""
    console = make_console(simulated=False, serial="FM-1")
    only = {c.name for c in console.link.dictionary.commands if c.simulator_only}
    assert only
    assert not only & {c.name for c in console.commands.visible()}
    with pytest.raises(Conflict, match="for simulators only") as caught:
        console.send("SIM_INJECT")
    assert caught.value.got == "FM-1 is real"
    assert any("for simulators only" in p for p in console.commands.check("SIM_INJECT", {}, user="ann").problems)


def test_simulator_commands_are_available_on_a_simulator(console):
    """Simulator commands are listed and permitted for a simulator."""
    assert "SIM_INJECT" in {c.name for c in console.commands.visible()}
    assert console.commands.check("SIM_INJECT", {}, user="ann").problems == ()


# --- the life of a command ---------------------------------------------------------------------------------------------


def test_a_missing_report_gives_unknown_and_a_retry_keeps_the_id(console):
    """A command without a report in time is unknown. A retry has the same id, and the device executes it once."""
    frames = console.sensor.memory.record.frames
    console.sensor.deaf = True
    row = console.end(console.send("TAKE_IMAGE"))
    assert (row.result, row.attempts) == ("unknown", 1)
    view = console.commands.view(row)
    assert (view.idempotent, view.can_retry) == (False, True)
    console.sensor.deaf = False
    retried = console.end(console.commands.retry(row.id, user="ann"))
    assert (retried.result, retried.request_id, retried.attempts) == ("completed", row.request_id, 2)
    assert console.sensor.memory.record.frames == frames + 1
    with pytest.raises(Conflict, match="only a command whose result is unknown"):
        console.commands.retry(row.id, user="ann")
    assert console.commands.get(row.id).result == "completed"


def test_a_late_report_during_a_retry_is_not_overwritten(console, monkeypatch):
    """The report arrives after the retry has read the row. The command is then completed, although the retry is rejected."""
    advance, delayed = console.sensor.device.next_frame, []

    def hold(now_s: float) -> None:
        if (frame := advance(now_s)) is not None:
            delayed.append(frame)

    monkeypatch.setattr(console.sensor.device, "next_frame", hold)
    row = console.end(console.send("TAKE_IMAGE"))
    assert row.result == "unknown"
    record, require = console.link.session._command_queue._records[row.request_id], console.authority.require

    def report_arrives(user: str) -> None:
        require(user)
        console.sensor.device.next_frame = lambda now_s: delayed.pop(0) if delayed else advance(now_s)
        console.wait(lambda: record.stage is Stage.COMPLETED)

    monkeypatch.setattr(console.authority, "require", report_arrives)
    with pytest.raises(Conflict, match="only a command whose result is unknown"):
        console.commands.retry(row.id, user="ann")
    console.wait(lambda: console.commands.get(row.id).result == "completed")


def test_a_late_report_is_recorded_and_marked(console):
    """If the reports of a command are delayed, it is unknown, then completed and marked as late, with an event."""
    advance = console.sensor.device.next_frame
    delayed: list[bytes] = []

    def hold(now_s: float) -> bytes | None:
        frame = advance(now_s)
        if frame is not None:
            delayed.append(frame)
        return None

    console.sensor.device.next_frame = hold
    row = console.end(console.send("GET_STATUS"))
    assert row.result == "unknown"
    console.sensor.device.next_frame = lambda now_s: delayed.pop(0) if delayed else advance(now_s)
    console.wait(lambda: console.commands.get(row.id).result == "completed")
    row = console.commands.get(row.id)
    assert row.late
    assert stages(row)[-1] == "completed"
    assert "unknown" in stages(row)
    console.wait(lambda: any("reported after the timeout" in e.text for e in console.bus.after(0, 1000)))


def test_an_operator_resolves_an_unknown_command(console):
    """A user without authority can resolve an unknown command once, with a note. Nothing is sent."""
    console.sensor.deaf = True
    row = console.end(console.send("GET_STATUS"))
    written = len(console.sensor.written)
    settled = console.commands.resolve(row.id, "seen in telemetry", user="bob")
    assert (settled.result, settled.resolved_note) == ("resolved", "bob: seen in telemetry")
    assert len(console.sensor.written) == written
    with pytest.raises(Conflict, match="only a command with the result unknown"):
        console.commands.resolve(row.id, "again", user="bob")


def test_a_queued_command_can_be_withdrawn_and_a_sent_one_not(console):
    """A queued command can be withdrawn, is not sent, and records the user. A sent command cannot be withdrawn."""
    console.sensor.deaf = True
    first, second = console.send("TAKE_IMAGE"), console.send("SET_EXPOSURE", exposure_ms=77)
    console.wait(lambda: console.commands.get(first.id).result == "sent")
    row = console.commands.withdraw(second.id, user="ann")
    assert (row.result, row.detail, stages(row)) == ("withdrawn", "withdrawn by ann", ["queued", "withdrawn"])
    with pytest.raises(Conflict, match="only a queued"):
        console.commands.withdraw(first.id, user="ann")
    console.sensor.deaf = False
    console.end(first)
    assert console.end(console.send("GET_STATUS")).result == "completed"
    assert console.link.session.housekeeping["exposure_ms"] != 77


def test_only_a_user_who_could_send_a_command_can_withdraw_it(console):
    """A user without authority or without permission for a command cannot withdraw it, and it remains queued."""
    console.sensor.deaf = True
    console.send("TAKE_IMAGE")
    row = console.send("SET_EXPOSURE", exposure_ms=77)
    console.authority.require("ann")
    with pytest.raises(Conflict, match="ann"):
        console.commands.withdraw(row.id, user="bob")

    console.refused = {"ann"}
    with pytest.raises(NotPermitted, match=r"command\.imager"):
        console.commands.withdraw(row.id, user="ann")
    assert console.commands.get(row.id).result == "queued"


def test_a_restarted_server_repeats_no_command(make_console):
    """After a restart, commands in progress are unknown and not repeated. Those that are not idempotent need the operator,
    and both kinds can be retried."""
    first = make_console()
    first.sensor.deaf = True
    image, status = first.send("TAKE_IMAGE"), first.send("GET_STATUS")
    first.wait(lambda: first.commands.get(image.id).result == "sent")
    first.link._stopping = True
    first.link._thread.join()
    frames = first.sensor.memory.record.frames
    first.commands._recorder._change(image.id, None, result="sent")  # the state after kill -9
    first.sensor.deaf = False

    second = make_console(first.sensor)
    rows = [second.commands.get(r.id) for r in (image, status)]
    assert [r.result for r in rows] == ["unknown", "unknown"]
    assert rows[0].detail.startswith("Needs operator")
    assert not rows[1].detail.startswith("Needs operator")
    assert second.end(second.send("GET_STATUS")).request_id > status.request_id
    assert second.sensor.memory.record.frames == frames
    assert second.end(second.commands.retry(image.id, user="ann")).result == "completed"
    assert second.sensor.memory.record.frames == frames + 1


def test_a_command_is_not_retried_on_another_unit(make_console, database):
    """The unit can change on the open line or during a restart of the server. The command can be retried when its unit is
    back."""
    first = make_console(serial="FM-1")
    first.sensor.deaf = True
    row = first.end(first.send("TAKE_IMAGE"))
    first.sensor.deaf = False
    assert first.commands.can_retry(row)
    first.sensor.device._identity = Identity(serial="FM-2")
    first.link.open_later(first.sensor.url)
    first.wait(lambda: first.link.hello is not None and first.link.hello.serial == "FM-2")
    assert not first.commands.can_retry(row)
    with pytest.raises(Conflict, match="another unit"):
        first.commands.retry(row.id, user="ann")

    with database.unit_of_work() as session:  # a command of a server that did not store the unit of each command
        session.get(Command, row.id).unit = ""
    second = make_console(serial="FM-2")
    frames = second.sensor.memory.record.frames
    assert not second.commands.can_retry(row)
    with pytest.raises(Conflict, match="another unit"):
        second.commands.retry(row.id, user="ann")
    assert (second.commands.get(row.id).result, second.sensor.memory.record.frames) == ("unknown", frames)

    third = make_console(serial="FM-1")
    assert third.end(third.commands.retry(row.id, user="ann")).result == "completed"


def test_a_command_of_a_unit_without_serial_number_can_be_retried_after_a_restart(make_console):
    """A unit without a serial number is named by its instrument and model. Its commands can be retried, but not on a unit with a
    serial number."""
    first = make_console(serial="")
    first.sensor.deaf = True
    row = first.end(first.send("TAKE_IMAGE"))
    first.sensor.deaf = False
    other = make_console(serial="FM-2")
    other.wait(lambda: other.link.hello is not None)
    with pytest.raises(Conflict, match="another unit"):
        other.commands.retry(row.id, user="ann")
    second = make_console(serial="")
    second.wait(lambda: second.link.hello is not None)
    assert second.end(second.commands.retry(row.id, user="ann")).result == "completed"


def test_a_command_queued_before_the_unit_is_known_stores_its_unit(console, database):
    """The unit of a command that was queued before a unit had identified itself is stored with its next stage."""
    console.sensor.deaf = True
    row = console.send("TAKE_IMAGE")
    with database.unit_of_work() as session:  # as if it had been queued before HELLO was answered
        session.get(Command, row.id).unit = ""
    assert console.end(row).result == "unknown"
    assert console.commands.get(row.id).unit == console.link.hello.unit_name


def test_abort_is_stored_without_the_unit_of_an_earlier_connection(console):
    """ABORT can be sent before the unit on the line has identified itself, so its events state no unit."""
    row = console.end(console.commands.abort(user="ann", source="abort").row(20))
    assert (row.result, row.unit) == ("completed", "")


def test_a_command_id_that_the_device_no_longer_stores_is_not_resent(console):
    """The device stores a limited number of ids. A retry of an older command is rejected unless it is idempotent."""
    console.sensor.deaf = True
    image, status = console.send("TAKE_IMAGE"), console.send("GET_STATUS")
    for row in (image, status):
        assert console.end(row).result == "unknown"
    console.sensor.deaf = False
    with console.link.lock:
        for _ in range(REMEMBERED_IDS):
            console.link.session.reserve()
    assert not console.commands.can_retry(console.commands.get(image.id))
    with pytest.raises(Conflict, match="does not store"):
        console.commands.retry(image.id, user="ann")
    assert console.end(console.commands.retry(status.id, user="ann")).result == "completed"


def test_a_command_is_not_resent_to_a_sensor_that_stores_no_results(console, monkeypatch):
    """A sensor that stores no results would execute a repeated command again. A retry is rejected unless the command is
    idempotent."""
    console.sensor.deaf = True
    image, status = (console.end(console.send(name)) for name in ("TAKE_IMAGE", "GET_STATUS"))
    monkeypatch.setattr(console.link.session, "stores_results", ExchangeSession.stores_results)
    assert [console.commands.can_retry(row) for row in (image, status)] == [False, True]
    with pytest.raises(Conflict, match="does not store"):
        console.commands.retry(image.id, user="ann")


def test_abort_needs_neither_store_nor_queue(console, monkeypatch):
    """ABORT is sent while the store is locked. It is recorded with all its stages when the store is available again."""

    def locked(*_: Any) -> None:
        raise StoreDown("the database cannot be used", got="database is locked")

    console.end(console.send("SET_MODE", mode="lost_in_space"))
    console.end(console.send("START_CYCLE"))
    with monkeypatch.context() as patched:
        patched.setattr(console.commands._recorder, "add", locked)
        receipt = console.commands.abort(user="bob", source="abort")
        console.wait(lambda: console.link.session.housekeeping["cycle_running"] is False)
        with pytest.raises(StoreDown, match="ABORT is queued for sending but is not stored"):
            receipt.row(0.0)
    assert stages(console.end(receipt.row(20)))[-1] == "completed"


def test_reports_during_a_store_lock_are_recorded_later(console, monkeypatch):
    """Reports received while the store is locked are recorded once and in order when it is available again."""

    def locked(*_: Any, **__: Any) -> None:
        raise StoreDown("the database cannot be used", got="database is locked")

    with monkeypatch.context() as patched:
        patched.setattr(console.commands._recorder, "_change", locked)
        rows = [console.send("SET_EXPOSURE", exposure_ms=100 + k) for k in range(3)]
        console.wait(lambda: console.link.session.housekeeping["exposure_ms"] == 102)
        assert {console.commands.get(row.id).result for row in rows} == {"queued"}
    for row in rows:
        assert console.end(row).result == "completed"
        assert stages(console.commands.get(row.id)) == [
            "queued",
            "released",
            "sent",
            "accepted",
            "started",
            "completed",
        ]


def test_an_abort_not_sent_before_a_link_loss_is_not_sent_later(console):
    """If the link is lost after ABORT was queued and before it is sent, ABORT ends as withdrawn and is not sent later."""
    console.sensor.cut = True
    with console.link.lock:
        issued = console.link.session.abort(console.link.monotonic_s())
        events = console.link.session.link_lost(console.link.monotonic_s())
    assert [(e.request_id, e.stage, e.reason) for e in events if e.name == "ABORT"][-1] == (
        issued,
        "failed",
        "withdrawn",
    )
    console.wait(lambda: not console.link.line_is_open)
    with pytest.raises(Conflict, match="ABORT was not sent"):
        console.commands.abort(user="bob", source="abort")


def test_abort_withdraws_queued_commands(console, monkeypatch):
    """ABORT withdraws twenty queued commands. Each records the user who aborted, also if the store was locked."""

    def locked(*_: Any) -> None:
        raise StoreDown("the database cannot be used", got="database is locked")

    for is_locked in (False, True):
        with console.link.lock:  # pauses the link
            waiting = [console.send("SET_EXPOSURE", exposure_ms=100 + k) for k in range(20)]
            with monkeypatch.context() as patched:
                if is_locked:
                    patched.setattr(console.commands._recorder, "add_withdrawn", locked)
                abort = console.commands.abort(user="bob", source="abort")
        ends = [console.end(row) for row in waiting]
        assert {(row.result, row.detail) for row in ends} == {("withdrawn", "ABORT by bob")}
        assert stages(ends[0]) == ["queued", "withdrawn"]
        assert all(row.finished is not None for row in ends)
        assert console.end(abort.row(20)).result == "completed"
        events = [event.text for event in console.bus.after(0, 1000) if event.text.startswith("ABORT by bob")]
        assert events[-1] == "ABORT by bob; withdrawn unsent: 20"
    assert console.end(console.send("GET_STATUS")).result == "completed"


def test_a_command_overtaken_by_abort_is_rejected(console, monkeypatch):
    """If ABORT is requested after a command was stored and before it is queued, the command is rejected with the reason."""
    add = console.commands._recorder.add

    def add_slowly(request_id: int, name: str, *rest: Any, **options: Any) -> Any:
        row = add(request_id, name, *rest, **options)
        if name != "ABORT":
            console.commands.abort(user="bob", source="abort")
        return row

    monkeypatch.setattr(console.commands._recorder, "add", add_slowly)
    with pytest.raises(Conflict, match="ABORT was requested before this command was sent"):
        console.send("SET_EXPOSURE", exposure_ms=77)
    row = next(row for row in console.history.page(Filter(), 20) if row.name == "SET_EXPOSURE")
    assert (row.result, "ABORT was requested before" in row.detail) == ("rejected", True)


# --- history -----------------------------------------------------------------------------------------------------------


@pytest.fixture
def full(console, clock):
    """Console with stored commands with different results, one minute apart."""
    for name, arguments in (
        ("SET_EXPOSURE", {"exposure_ms": 123}),
        ("FIND_CENTROIDS", {"slot": 3}),
        ("GET_STATUS", {}),
        ("SET_EXPOSURE", {"exposure_ms": 250}),
    ):
        console.end(console.send(name, **arguments))
        clock.forward(60)
    return console


def test_history_is_searched_by_every_field(full, clock):
    """The history is filtered by span, name, result, user, contact and text, alone and combined, and paged by id."""

    def found(**wanted: Any) -> list[str]:
        return [f"{r.name} {r.result}" for r in full.history.page(Filter(**wanted), 100)]

    everything = found()
    assert everything == [
        "SET_EXPOSURE completed",
        "GET_STATUS completed",
        "FIND_CENTROIDS failed",
        "SET_EXPOSURE completed",
    ]
    start = clock.at - timedelta(seconds=240)
    assert found(start=start, end=start + timedelta(seconds=60)) == everything[3:]
    assert found(names=("GET_STATUS", "FIND_CENTROIDS")) == everything[1:3]
    assert found(results=("failed",)) == [everything[2]]
    assert found(user="ann") == everything
    assert found(user="bob") == found(contact_id=full.link.contact_id + 1) == found(source="stack") == []
    assert found(contact_id=full.link.contact_id) == everything
    assert found(text="123") == [everything[3]]
    assert found(text="NO_IMAGE") == [everything[2]]
    assert found(text="%") == []
    assert found(text="exposure", results=("completed",), end=start + timedelta(seconds=60)) == [everything[3]]
    newest = full.history.page(Filter(), 2)
    assert [r.id for r in full.history.page(Filter(), 2, newest[-1].id)] == [newest[-1].id - 1, newest[-1].id - 2]
    assert full.history.facets()["names"] == ["FIND_CENTROIDS", "GET_STATUS", "SET_EXPOSURE"]
    with pytest.raises(BadInput, match="span is empty"):
        full.history.page(Filter(start=start, end=start), 5)


@pytest.mark.parametrize("search", [Filter(), Filter(names=("SET_EXPOSURE",)), Filter(text="nothing has this")])
def test_exports_contain_exactly_the_search_result(full, search):
    """JSON and CSV exports have the same commands as the page, oldest first."""
    page = full.history.page(search, 100)
    exported = json.loads("".join(full.history.json(search)))
    assert [e["id"] for e in exported] == [row.id for row in reversed(page)]
    table = list(csv.DictReader(io.StringIO("".join(full.history.csv(search)))))
    assert [int(line["id"]) for line in table] == [e["id"] for e in exported]
    for line, record in zip(table, exported, strict=True):
        assert json.loads(line["arguments"]) == record["arguments"]
        assert json.loads(line["stages"]) == record["stages"]
        assert line["created"] == record["created"]
        assert line["created"].endswith("Z")

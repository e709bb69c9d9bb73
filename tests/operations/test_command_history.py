"""Commands under way and afterwards: authority, hazards, late reports, retries, restarts, and the searchable record."""

from __future__ import annotations

import csv
import io
import json
from datetime import timedelta
from typing import Any

import pytest

from gss.domain.errors import BadInput, Conflict, NotPermitted
from gss.operations.commanding.command_history import Filter
from gss.operations.commanding.commanding import REMEMBERED_IDS

pytestmark = pytest.mark.timeout(120)


@pytest.fixture
def desk(make_desk):
    """A desk with a sensor that has answered."""
    return make_desk()


def stages(row: Any) -> list[str]:
    return [stage.stage for stage in row.stages]


# --- authority and hazards ---------------------------------------------------------------------------------------------


def test_a_command_of_another_is_refused_with_the_holders_name(desk):
    """The first command takes authority; another's is refused and leaves no row; ABORT of anybody goes out."""
    assert desk.end(desk.send("GET_STATUS")).result == "completed"
    assert desk.authority.holder() == "ann"
    before = len(desk.history.page(Filter(), 100))
    with pytest.raises(Conflict, match="held by ann"):
        desk.send("GET_STATUS", user="bob")
    assert len(desk.history.page(Filter(), 100)) == before
    assert any("held by ann" in p for p in desk.commands.check("GET_STATUS", {}, user="bob").problems)
    assert desk.end(desk.commands.abort(user="bob", source="abort").row(20)).result == "completed"
    desk.authority.break_("bob", "pass begins")
    assert desk.end(desk.send("GET_STATUS", user="bob")).result == "completed"


def test_a_command_that_is_refused_does_not_take_authority(desk):
    """Bad arguments, no confirmation: nobody holds it afterwards."""
    for name, arguments in (("SET_EXPOSURE", {"exposure_ms": 99_999}), ("RESET", {})):
        with pytest.raises(BadInput):
            desk.send(name, **arguments)
    assert desk.authority.holder() is None


def test_the_chosen_value_decides_what_must_be_confirmed(desk):
    """POWER on is harmless, POWER off wants a yes: the hazard belongs to the value."""
    assert desk.end(desk.send("POWER", rail="imager", state="on")).result == "completed"
    with pytest.raises(BadInput, match="POWER was not confirmed"):
        desk.send("POWER", rail="imager", state="off")
    check = desk.commands.check("POWER", {"rail": "imager", "state": "off"}, user="ann")
    assert (check.risk.hazard, check.risk.name, check.problems) == ("warning", "POWER", ())
    assert desk.commands.check("POWER", {"state": "on"}, user="ann").risk.hazard == "none"
    assert desk.send("POWER", rail="imager", state="off", confirm="yes").name == "POWER"


def test_schedule_is_as_dangerous_as_what_it_carries(desk):
    """The inner command's name must be typed; SCHEDULE's own is not enough."""
    dictionary = desk.link.dictionary
    erase = dictionary.command("ERASE_BANK")
    order = {"at_s": 1e6, "command_code": erase.code, "length": 1, "payload": "02" + "00" * 63}
    check = desk.commands.check("SCHEDULE", order, user="ann")
    assert (check.risk.hazard, check.risk.name) == ("critical", "ERASE_BANK")
    for confirm in ("", "yes", "SCHEDULE"):
        with pytest.raises(BadInput, match="ERASE_BANK is critical"):
            desk.send("SCHEDULE", confirm=confirm, **order)
    harmless = order | {"command_code": dictionary.command("GET_STATUS").code, "length": 0}
    assert desk.commands.check("SCHEDULE", harmless, user="ann").risk.hazard == "watch"


def test_commands_for_simulators_stay_away_from_a_real_unit(make_desk):
    """They are neither shown nor sent to a device that says simulated = false."""
    desk = make_desk(simulated=False, serial="FM-1")
    only = {c.name for c in desk.link.dictionary.commands if c.simulator_only}
    assert only
    assert not only & {c.name for c in desk.commands.visible()}
    with pytest.raises(Conflict, match="for simulators only") as caught:
        desk.send("SIM_INJECT")
    assert caught.value.got == "FM-1 is real"
    assert any("for simulators only" in p for p in desk.commands.check("SIM_INJECT", {}, user="ann").problems)


def test_commands_for_simulators_are_there_on_a_simulator(desk):
    """The training panel needs them."""
    assert "SIM_INJECT" in {c.name for c in desk.commands.visible()}
    assert desk.commands.check("SIM_INJECT", {}, user="ann").problems == ()


# --- the life of a command ---------------------------------------------------------------------------------------------


def test_silence_is_unknown_and_the_same_id_settles_it(desk):
    """No report in time: unknown. The retry has the same id, and the device runs it once."""
    frames = desk.sensor.memory.record.frames
    desk.sensor.deaf = True
    row = desk.end(desk.send("TAKE_IMAGE"))
    assert (row.result, row.attempts) == ("unknown", 1)
    view = desk.commands.view(row)
    assert (view.idempotent, view.can_retry) == (False, True)
    desk.sensor.deaf = False
    again = desk.end(desk.commands.retry(row.id, user="ann"))
    assert (again.result, again.request_id, again.attempts) == ("completed", row.request_id, 2)
    assert desk.sensor.memory.record.frames == frames + 1
    with pytest.raises(Conflict, match="only a command whose fate is unknown"):
        desk.commands.retry(row.id, user="ann")


def test_a_late_report_is_recorded_and_says_so(desk):
    """The command ran, its reports were held up: unknown, then completed, marked late; and an event tells."""
    advance = desk.sensor.device.next_frame
    held: list[bytes] = []

    def hold(now_s: float) -> bytes | None:
        frame = advance(now_s)
        if frame is not None:
            held.append(frame)
        return None

    desk.sensor.device.next_frame = hold
    row = desk.end(desk.send("GET_STATUS"))
    assert row.result == "unknown"
    desk.sensor.device.next_frame = lambda now_s: held.pop(0) if held else advance(now_s)
    desk.wait(lambda: desk.commands.get(row.id).result == "completed")
    row = desk.commands.get(row.id)
    assert row.late
    assert stages(row)[-1] == "completed"
    assert "unknown" in stages(row)
    desk.wait(lambda: any("after all, late" in e.text for e in desk.bus.after(0, 1000)))


def test_an_operator_settles_what_nobody_knows(desk):
    """Resolve needs no authority and sends nothing; a report that comes later is kept beside the operator's word."""
    desk.sensor.deaf = True
    row = desk.end(desk.send("GET_STATUS"))
    written = len(desk.sensor.written)
    settled = desk.commands.resolve(row.id, "seen in telemetry", user="bob")
    assert (settled.result, settled.resolved_note) == ("resolved", "bob: seen in telemetry")
    assert len(desk.sensor.written) == written
    with pytest.raises(Conflict, match="only an unknown"):
        desk.commands.resolve(row.id, "again", user="bob")


def test_a_waiting_command_can_be_withdrawn_and_a_sent_one_not(desk):
    """Nothing of it reaches the line; the record says who took it back."""
    desk.sensor.deaf = True
    first, second = desk.send("TAKE_IMAGE"), desk.send("SET_EXPOSURE", exposure_ms=77)
    desk.wait(lambda: desk.commands.get(first.id).result == "sent")
    row = desk.commands.withdraw(second.id, user="ann")
    assert (row.result, row.detail, stages(row)) == ("withdrawn", "taken back by ann", ["queued", "withdrawn"])
    with pytest.raises(Conflict, match="only a queued"):
        desk.commands.withdraw(first.id, user="ann")
    desk.sensor.deaf = False
    desk.end(first)
    assert desk.end(desk.send("GET_STATUS")).result == "completed"
    assert desk.link.session.housekeeping["exposure_ms"] != 77


def test_only_who_could_send_a_command_can_take_it_back(desk):
    """Whose role lacks its group is refused, and so is who does not hold the authority; it stays in the queue."""
    desk.sensor.deaf = True
    desk.send("TAKE_IMAGE")
    row = desk.send("SET_EXPOSURE", exposure_ms=77)
    desk.authority.require("ann")
    with pytest.raises(Conflict, match="ann"):
        desk.commands.withdraw(row.id, user="bob")

    desk.refused = {"ann"}
    with pytest.raises(NotPermitted, match=r"command\.imager"):
        desk.commands.withdraw(row.id, user="ann")
    assert desk.commands.get(row.id).result == "queued"


def test_nothing_is_repeated_by_a_server_that_restarts(make_desk):
    """What was under way is unknown and needs the operator; what could be repeated says so; both can be retried by hand."""
    first = make_desk()
    first.sensor.deaf = True
    image, status = first.send("TAKE_IMAGE"), first.send("GET_STATUS")
    first.wait(lambda: first.commands.get(image.id).result == "sent")
    first.link._stopping = True
    first.link._thread.join()
    frames = first.sensor.memory.record.frames
    first.commands._recorder._change(image.id, None, result="sent")  # as kill -9 would have left it
    first.sensor.deaf = False

    second = make_desk(first.sensor)
    rows = [second.commands.get(r.id) for r in (image, status)]
    assert [r.result for r in rows] == ["unknown", "unknown"]
    assert rows[0].detail.startswith("Needs operator")
    assert not rows[1].detail.startswith("Needs operator")
    assert second.end(second.send("GET_STATUS")).request_id > status.request_id
    assert second.sensor.memory.record.frames == frames
    assert second.end(second.commands.retry(image.id, user="ann")).result == "completed"
    assert second.sensor.memory.record.frames == frames + 1


def test_an_id_that_the_device_has_forgotten_is_not_sent_again(desk):
    """The ring holds so many ids; an older one that must not run twice is refused, one that may is not."""
    desk.sensor.deaf = True
    image, status = desk.send("TAKE_IMAGE"), desk.send("GET_STATUS")
    for row in (image, status):
        assert desk.end(row).result == "unknown"
    desk.sensor.deaf = False
    with desk.link.lock:
        for _ in range(REMEMBERED_IDS):
            desk.link.session.reserve()
    assert not desk.commands.can_retry(desk.commands.get(image.id))
    with pytest.raises(Conflict, match="no longer remembers"):
        desk.commands.retry(image.id, user="ann")
    assert desk.end(desk.commands.retry(status.id, user="ann")).result == "completed"


def test_abort_needs_neither_store_nor_queue(desk, monkeypatch):
    """While the store is locked ABORT goes out; it is recorded with all its stages when the store is back."""
    from gss.domain.errors import StoreDown

    def locked(*_: Any) -> None:
        raise StoreDown("the database cannot be used now", got="database is locked")

    desk.end(desk.send("SET_MODE", mode="lost_in_space"))
    desk.end(desk.send("START_CYCLE"))
    with monkeypatch.context() as patched:
        patched.setattr(desk.commands._recorder, "add", locked)
        receipt = desk.commands.abort(user="bob", source="abort")
        desk.wait(lambda: desk.link.session.housekeeping["cycle_running"] is False)
        with pytest.raises(StoreDown, match="ABORT is queued for the line but not recorded yet"):
            receipt.row(0.0)
    assert stages(desk.end(receipt.row(20)))[-1] == "completed"


def test_reports_that_a_locked_store_cannot_take_are_recorded_later(desk, monkeypatch):
    """Every stage of every command that completed meanwhile is on the record once the store is back, in order and once."""
    from gss.domain.errors import StoreDown

    def locked(*_: Any, **__: Any) -> None:
        raise StoreDown("the database cannot be used now", got="database is locked")

    with monkeypatch.context() as patched:
        patched.setattr(desk.commands._recorder, "_change", locked)
        rows = [desk.send("SET_EXPOSURE", exposure_ms=100 + k) for k in range(3)]
        desk.wait(lambda: desk.link.session.housekeeping["exposure_ms"] == 102)
        assert {desk.commands.get(row.id).result for row in rows} == {"queued"}
    for row in rows:
        assert desk.end(row).result == "completed"
        assert stages(desk.commands.get(row.id)) == ["queued", "released", "sent", "accepted", "started", "completed"]


def test_abort_that_the_line_lost_is_not_sent_on_the_next_one(desk):
    """ABORT was accepted, and the line is lost before it leaves: it ends as withdrawn and never reaches the device."""
    desk.sensor.cut = True
    with desk.link.lock:
        issued = desk.link.session.abort(desk.link.monotonic_s())
        events = desk.link.session.link_lost(desk.link.monotonic_s())
    assert [(e.request_id, e.stage, e.reason) for e in events if e.name == "ABORT"][-1] == (
        issued,
        "failed",
        "withdrawn",
    )
    desk.wait(lambda: not desk.link.line_is_open)
    with pytest.raises(Conflict, match="ABORT was not sent"):
        desk.commands.abort(user="bob", source="abort")


def test_abort_takes_back_what_waits(desk, monkeypatch):
    """Of twenty commands that wait none is sent after ABORT: each ends as withdrawn with who aborted, also where the store was
    locked at that moment."""
    from gss.domain.errors import StoreDown

    def locked(*_: Any) -> None:
        raise StoreDown("the database cannot be used now", got="database is locked")

    for is_locked in (False, True):
        with desk.link.lock:  # the line stands still while it is held
            waiting = [desk.send("SET_EXPOSURE", exposure_ms=100 + k) for k in range(20)]
            with monkeypatch.context() as patched:
                if is_locked:
                    patched.setattr(desk.commands._recorder, "taken_back", locked)
                abort = desk.commands.abort(user="bob", source="abort")
        ends = [desk.end(row) for row in waiting]
        assert {(row.result, row.detail) for row in ends} == {("withdrawn", "ABORT by bob")}
        assert stages(ends[0]) == ["queued", "withdrawn"]
        assert all(row.finished is not None for row in ends)
        assert desk.end(abort.row(20)).result == "completed"
        told = [event.text for event in desk.bus.after(0, 1000) if event.text.startswith("ABORT by bob")]
        assert told[-1] == "ABORT by bob; withdrawn unsent: 20"
    assert desk.end(desk.send("GET_STATUS")).result == "completed"


def test_a_command_that_abort_overtakes_is_refused(desk, monkeypatch):
    """ABORT comes between the row of a command and its place in the queue: it is not sent, and its row says why."""
    add = desk.commands._recorder.add

    def add_slowly(request_id: int, name: str, *rest: Any) -> Any:
        row = add(request_id, name, *rest)
        if name != "ABORT":
            desk.commands.abort(user="bob", source="abort")
        return row

    monkeypatch.setattr(desk.commands._recorder, "add", add_slowly)
    with pytest.raises(Conflict, match="ABORT came before it was sent"):
        desk.send("SET_EXPOSURE", exposure_ms=77)
    row = next(row for row in desk.history.page(Filter(), 20) if row.name == "SET_EXPOSURE")
    assert (row.result, "ABORT came before" in row.detail) == ("rejected", True)


# --- history -----------------------------------------------------------------------------------------------------------


@pytest.fixture
def full(desk, clock):
    """Some commands with different fates, a minute apart."""
    for name, arguments in (
        ("SET_EXPOSURE", {"exposure_ms": 123}),
        ("FIND_CENTROIDS", {"slot": 3}),
        ("GET_STATUS", {}),
        ("SET_EXPOSURE", {"exposure_ms": 250}),
    ):
        desk.end(desk.send(name, **arguments))
        clock.forward(60)
    return desk


def test_history_is_searched_by_everything_it_knows(full, clock):
    """Span, name, result, user, contact and text, alone and together; pages follow by id."""

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


@pytest.mark.parametrize("wanted", [Filter(), Filter(names=("SET_EXPOSURE",)), Filter(text="nothing has this")])
def test_exports_hold_exactly_what_was_searched(full, wanted):
    """Both formats, oldest first, equal to each other and to the page."""
    page = full.history.page(wanted, 100)
    exported = json.loads("".join(full.history.json(wanted)))
    assert [e["id"] for e in exported] == [row.id for row in reversed(page)]
    table = list(csv.DictReader(io.StringIO("".join(full.history.csv(wanted)))))
    assert [int(line["id"]) for line in table] == [e["id"] for e in exported]
    for line, record in zip(table, exported, strict=True):
        assert json.loads(line["arguments"]) == record["arguments"]
        assert json.loads(line["stages"]) == record["stages"]
        assert line["created"] == record["created"]
        assert line["created"].endswith("Z")

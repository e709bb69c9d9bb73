"""Commands: checked, confirmed, queued, followed to their end, and never sent twice by software."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from gss.device.dictionary import Command as Definition
from gss.device.dictionary import Hazard
from gss.device.session_events import FINAL_STAGES, CommandStage, DeviceEvent, SessionEvent, Stage
from gss.domain.errors import BadInput, Conflict, GssError
from gss.operations.clock import Now
from gss.operations.events import EventBus
from gss.operations.link import LinkService
from gss.store import commands as store
from gss.store.engine import Database
from gss.store.models import Command
from gss.store.models import CommandStage as StageRow

NEEDS_OPERATOR = "the server restarted while this command was under way; it may have run or not"


@dataclass(frozen=True)
class PreconditionState:
    """A condition, whether it holds (None: not known), and the value that decides it."""

    text: str
    met: bool | None
    value: str


@dataclass(frozen=True)
class Check:
    """Dry run: ``groups`` are (label, bytes) of the packet before framing; empty where the arguments are bad."""

    problems: tuple[str, ...]
    preconditions: tuple[PreconditionState, ...]
    groups: tuple[tuple[str, bytes], ...]


class CommandService:
    """What an operator does to the sensor, one command at a time."""

    def __init__(self, link: LinkService, database: Database, bus: EventBus, now: Now) -> None:
        self._link, self._database, self._bus, self._now = link, database, bus, now
        self.completed_hooks: list[Callable[[str, Mapping[str, Any], Mapping[str, Any]], None]] = []

    def start(self) -> None:
        """Commands that were under way when the last server died become unknown; nothing is sent again by itself."""
        in_flight: list[tuple[int, str, Mapping[str, Any]]] = []
        with self._database.unit_of_work() as session:
            for row in store.left_in_flight(session):
                row.result, row.detail = "unknown", NEEDS_OPERATOR
                row.stages.append(StageRow(stage="unknown", at=self._now(), detail=NEEDS_OPERATOR))
                in_flight.append((row.request_id, row.name, row.arguments))
            last = store.last_request_id(session)
        with self._link.lock:
            self._link.session.restore(last + 1, in_flight)

    def preconditions(self, definition: Definition) -> tuple[PreconditionState, ...]:
        """Each condition of a command with its present state."""
        housekeeping = self._link.session.housekeeping
        states = []
        for condition in definition.preconditions:
            value = None if housekeeping is None else housekeeping.get(condition.field)
            states.append(PreconditionState(condition.text, condition.met(housekeeping), _words(value)))
        return tuple(states)

    def check(self, name: str, arguments: Mapping[str, Any]) -> Check:
        """What would be sent, and what stands in the way. Nothing is sent."""
        definition = self._link.dictionary.command(name)
        states = self.preconditions(definition)
        problems = [f"{state.text}: it is {state.value}" for state in states if state.met is False]
        if not self._link.connected:
            problems.append(f"the line is down: {self._link.reason}")
        groups: list[tuple[str, bytes]] = []
        try:
            with self._link.lock:
                groups = self._link.session.preview(name, arguments)
        except GssError as error:
            problems.append(str(error))
        return Check(tuple(problems), states, tuple(groups))

    def send(self, name: str, arguments: Mapping[str, Any], *, confirm: str, user: str, source: str) -> Command:
        """Queue a command; its row comes back at once. Conflict or BadInput says why not."""
        definition = self._link.dictionary.command(name)
        if name == "ABORT":
            return self.abort(user=user, source=source)
        _check_confirmation(definition, confirm)
        self._check_line()
        unmet = [state for state in self.preconditions(definition) if state.met is False]
        if unmet:
            state = unmet[0]
            raise Conflict(f"{name} is not allowed now", expected=state.text.lower(), got=state.value)
        with self._link.lock:
            self._link.session.preview(name, arguments)
            # The row first: what cannot be recorded is not sent.
            row = self._add(self._link.session.next_request_id, name, arguments, user, source)
            try:
                self._link.session.submit(name, arguments, self._link.monotonic_s())
            except GssError as error:
                stage = StageRow(stage="rejected", at=self._now(), detail=str(error))
                self._change(row.id, stage, result="rejected", detail=str(error), finished=self._now())
                raise
        self._bus.publish("command", row)
        return row

    def abort(self, *, user: str, source: str) -> Command:
        """ABORT, ahead of everything, no questions."""
        self._check_line()
        with self._link.lock:
            request_id = self._link.session.abort(
                self._link.monotonic_s()
            )  # nothing may stand in its way, not even the store
            row = self._add(request_id, "ABORT", {}, user, source)
        self._bus.record("command", "watch", f"ABORT by {user}", command_id=row.id)
        self._bus.publish("command", row)
        return row

    def retry(self, command_id: int, *, user: str) -> Command:
        """Send the same bytes with the same id once more; only while the fate is unknown."""
        self._check_line()
        row = self.get(command_id)
        with self._link.lock:
            self._link.session.retry(row.request_id, self._link.monotonic_s())
            row = self._change(
                command_id, StageRow(stage="queued", at=self._now(), detail=f"retry by {user}"), result="queued"
            )
        self._bus.record("command", "ok", f"{row.name} retried with the same id by {user}", command_id=row.id)
        return row

    def resolve(self, command_id: int, note: str, *, user: str) -> Command:
        """An operator settles an unknown command with a note; nothing is sent."""
        row = self.get(command_id)
        if row.result != "unknown":
            raise Conflict("only an unknown command can be marked resolved", got=row.result)
        row = self._change(command_id, None, result="resolved", resolved_note=f"{user}: {note}", finished=self._now())
        self._bus.record("command", "ok", f"{row.name} marked resolved by {user}: {note}", command_id=row.id)
        return row

    def get(self, command_id: int) -> Command:
        """The command of that id."""
        with self._database.unit_of_work() as session:
            return store.get(session, command_id)

    def newest(self, limit: int, contact_id: int | None) -> list[Command]:
        """Newest commands first."""
        with self._database.unit_of_work() as session:
            return store.newest(session, limit, contact_id)

    def handle(self, events: Sequence[SessionEvent]) -> None:
        """Follow the reports of commands and keep the device's events."""
        for event in events:
            if isinstance(event, CommandStage):
                self._follow(event)
            elif isinstance(event, DeviceEvent):
                self._bus.record("device", event.severity, f"{event.name}: {event.text}" if event.text else event.name)

    def _follow(self, event: CommandStage) -> None:
        with self._database.unit_of_work() as session:
            found = store.by_request(session, event.request_id)
        if found is None:
            return  # HELLO and other commands of the session itself have no row
        detail = " ".join(word for word in (event.reason, event.detail) if word)
        stage = StageRow(stage=str(event.stage), at=self._now(), detail=detail)
        if event.stage is Stage.QUEUED:
            return
        values: dict[str, Any] = {"result": str(event.stage), "attempts": max(found.attempts, event.attempt)}
        if found.result == "resolved":
            values.pop("result")
        if detail or event.stage in FINAL_STAGES:
            values["detail"] = detail  # an end without words takes back what was said while the fate was unknown
        if event.late:
            values["late"] = True
        if event.stage in FINAL_STAGES:
            values["finished"] = stage.at
        if event.stage is Stage.COMPLETED:
            values["values"] = {k: v.hex() if isinstance(v, bytes) else v for k, v in event.values.items()}
        row = self._change(found.id, stage, **values)
        if event.stage is Stage.UNKNOWN:
            self._bus.record("command", "warning", f"{row.name}: no report in time, fate unknown", command_id=row.id)
        if event.stage is Stage.COMPLETED:
            for hook in self.completed_hooks:
                hook(row.name, row.arguments, event.values)

    def _change(self, command_id: int, stage: StageRow | None, **values: Any) -> Command:
        with self._database.unit_of_work() as session:
            row = store.get(session, command_id)
            for name, value in values.items():
                setattr(row, name, value)
            if stage is not None:
                row.stages.append(stage)
        self._bus.publish("command", row)
        return row

    def _add(self, request_id: int, name: str, arguments: Mapping[str, Any], user: str, source: str) -> Command:
        with self._database.unit_of_work() as session:
            return store.add(
                session,
                self._now(),
                contact_id=self._link.contact_id,
                request_id=request_id,
                name=name,
                arguments=dict(arguments),
                user=user,
                source=source,
            )

    def _check_line(self) -> None:
        if not self._link.connected:
            raise Conflict("the line is down", got=self._link.reason, hint="open the port first")


def _words(value: Any) -> str:
    """A telemetry value as an operator reads it."""
    if value is None:
        return "not received"
    return {True: "yes", False: "no"}[value] if isinstance(value, bool) else str(value).replace("_", " ")


def _check_confirmation(definition: Definition, confirm: str) -> None:
    """A critical command wants its name typed, a warning one a yes."""
    if definition.hazard is Hazard.CRITICAL and confirm != definition.name:
        raise BadInput(
            f"{definition.name} is critical and was not confirmed", expected=f"the name {definition.name} typed"
        )
    if definition.hazard is Hazard.WARNING and confirm not in ("yes", definition.name):
        raise BadInput(f"{definition.name} was not confirmed", expected="a yes: " + definition.hazard_reason)

"""Record of commands: one row per command, with all stages that the command reached."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from typing import Any

from gss.device.session_commands import WITHDRAWN
from gss.device.session_events import FINAL_STAGES, CommandUpdate, Stage
from gss.operations.clock import Now
from gss.operations.events import EventBus
from gss.operations.line.deferred_writes import DeferredWrites
from gss.operations.line.dispatcher import LineEventQueue
from gss.operations.line.line_events import ServiceEvent
from gss.store import commands as store
from gss.store.engine import Database
from gss.store.models import Command
from gss.store.models import CommandStage as StageRow


@dataclass(frozen=True)
class CommandView:
    """A command's row. ``can_retry``: True if the command can be sent again now with the same request id."""

    row: Command
    idempotent: bool
    can_retry: bool


@dataclass(frozen=True)
class CommandCompleted(ServiceEvent):
    """A command completed. ``values``: values in its report."""

    command_id: int
    name: str
    arguments: Mapping[str, Any]
    values: Mapping[str, Any]


@dataclass(frozen=True)
class CommandChanged(ServiceEvent):
    """A command's record changed. ``result``: its current result."""

    command_id: int
    result: str


class CommandRecorder:
    """Stores rows and stages of commands. Each change is published on the bus and as CommandChanged on the line's event queue."""

    def __init__(
        self,
        database: Database,
        bus: EventBus,
        now: Now,
        view: Callable[[Command], CommandView],
        events: LineEventQueue,
        writes: DeferredWrites,
    ) -> None:
        self._writes = writes
        self._database, self._bus, self._now, self._view, self._events = database, bus, now, view, events
        self._completed: list[CommandCompleted] = []
        self._lock = threading.RLock()  # keeps the stages of a row in order of arrival

    def is_stored(self, request_id: int, at: datetime) -> bool:
        """True if the command with this id, created at this time, has a row."""
        with self._database.unit_of_work() as session:
            row = store.by_request(session, request_id)
        return row is not None and row.created == at

    def add(
        self,
        request_id: int,
        name: str,
        arguments: Mapping[str, Any],
        user: str,
        source: str,
        contact_id: int | None,
        run_id: int | None,
        at: datetime | None = None,
        unit: str = "",
    ) -> Command:
        """Store and return the row of a command that will be queued."""
        with self._database.unit_of_work() as session:
            row = store.add(
                session,
                at or self._now(),
                contact_id=contact_id,
                request_id=request_id,
                name=name,
                arguments=dict(arguments),
                user=user,
                source=source,
                run_id=run_id,
                unit=unit,
            )
        self._bus.publish("command", self._view(row))
        return row

    @staticmethod
    def lose(row: Command, at: datetime, detail: str) -> None:
        """Mark a row as unknown, because its command was in progress when the server stopped."""
        row.result, row.detail = "unknown", detail
        row.stages.append(StageRow(stage="unknown", at=at, detail=detail))

    def refuse(self, command_id: int, detail: str) -> Command:
        """Mark a command as rejected, because it could not be queued."""
        return self._end(command_id, "rejected", detail)

    def withdrawn(self, command_id: int, stage: CommandUpdate) -> Command:
        """Record that a command was withdrawn. If a retry was withdrawn, the result remains unknown, as before the retry."""
        if stage.stage is Stage.UNKNOWN:
            return self._change(command_id, self._stage("unknown", stage.detail), result="unknown", detail=stage.detail)
        return self._end(command_id, WITHDRAWN, stage.detail)

    def add_withdrawn(self, events: Sequence[CommandUpdate]) -> None:
        """Record several withdrawn commands in one transaction."""
        rows = []
        with self._lock, self._database.unit_of_work() as session:
            for event in events:
                row = store.by_request(session, event.request_id)
                if row is None or row.result != "queued":
                    continue
                row.result = "unknown" if event.stage is Stage.UNKNOWN else WITHDRAWN
                row.detail = event.detail
                stage = self._stage(row.result, event.detail)
                row.stages.append(stage)
                row.finished = None if event.stage is Stage.UNKNOWN else stage.at
                rows.append(row)
        for row in rows:
            self._publish(row)

    def _end(self, command_id: int, result: str, detail: str) -> Command:
        stage = self._stage(result, detail)
        return self._change(command_id, stage, result=result, detail=detail, finished=stage.at)

    def requeue(self, command_id: int, detail: str) -> Command:
        """Record that a retry is queued."""
        return self._change(command_id, self._stage("queued", detail), result="queued")

    def still_unknown(self, command_id: int, detail: str) -> Command:
        """Record that a retry could not be queued. The result remains unknown."""
        return self._change(command_id, self._stage("unknown", detail), result="unknown", detail=detail)

    def resolve(self, command_id: int, note: str) -> Command:
        """Record that an operator resolved a command with an unknown result."""
        return self._change(command_id, None, result="resolved", resolved_note=note, finished=self._now())

    def _stage(self, name: str, detail: str, at: datetime | None = None) -> StageRow:
        return StageRow(stage=name, at=at or self._now(), detail=detail)

    # --- reports ------------------------------------------------------------------------------------------------

    def follow(self, event: CommandUpdate, at: datetime) -> None:
        """Store a stage that a command reached at ``at``. Commands of the session itself, for example HELLO, have no row and are
        ignored."""
        if event.stage is Stage.QUEUED:
            return
        with self._lock:
            with self._database.unit_of_work() as session:
                row = store.by_request(session, event.request_id)
            if row is not None:
                self._write(row, event, at)

    def _write(self, command: Command, event: CommandUpdate, at: datetime) -> None:
        if event.stage is Stage.UNKNOWN and command.result == "unknown":
            return  # the start of this server already recorded the command as unknown
        detail = " ".join(word for word in (event.reason, event.detail) if word)
        if event.reason == WITHDRAWN:
            self._end(command.id, WITHDRAWN, event.detail)
            self._announce("warning", f"{command.name} was not sent: {event.detail}", command.id)
            return
        stage = self._stage(str(event.stage), detail, at)
        values: dict[str, object] = {"result": stage.stage, "attempts": max(command.attempts, event.attempt)}
        if command.result == "resolved":
            # Keep the operator's resolution as the result; only add the late stage to the list of stages.
            values.pop("result")
        if detail or event.stage in FINAL_STAGES:
            values["detail"] = detail  # a final stage without detail clears the text of the unknown result
        if event.unit and not command.unit:
            values["unit"] = event.unit  # it was queued before the unit had identified itself
        if event.late:
            values["late"] = True
        if event.stage in FINAL_STAGES:
            values["finished"] = stage.at
        if event.stage is Stage.COMPLETED:
            values["values"] = {k: v.hex() if isinstance(v, bytes) else v for k, v in event.values.items()}
        row = self._change(command.id, stage, **values)
        self._record_event(row, event)

    def _record_event(self, row: Command, event: CommandUpdate) -> None:
        if event.stage is Stage.UNKNOWN:
            self._announce("warning", f"{row.name}: no report before the timeout, outcome unknown", row.id)
        if row.late and event.stage in FINAL_STAGES:
            self._announce("watch", f"{row.name}: {event.stage} reported after the timeout", row.id)
        if event.stage is Stage.COMPLETED:
            self._completed.append(CommandCompleted(row.id, row.name, row.arguments, event.values))

    def _announce(self, severity: str, text: str, command_id: int) -> None:
        """Queue an event about a stored row as a separate write, so that a failure of the store does not repeat the row."""
        self._writes.add(partial(self._bus.record, "command", severity, text, command_id=command_id))

    def take_completed(self) -> list[CommandCompleted]:
        """Return the commands that completed since the last call."""
        with self._lock:
            completed, self._completed = self._completed, []
        return completed

    def _change(self, command_id: int, stage: StageRow | None, **values: Any) -> Command:
        with self._database.unit_of_work() as session:
            row = store.get(session, command_id)
            for name, value in values.items():
                setattr(row, name, value)
            if stage is not None:
                row.stages.append(stage)
        self._publish(row)
        return row

    def _publish(self, row: Command) -> None:
        self._bus.publish("command", self._view(row))
        self._events.publish([CommandChanged(row.id, row.result)])

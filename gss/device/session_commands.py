"""Command queue of a host session: timeouts, unknown outcomes, retry, abort. No I/O."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Unpack

from gss.device.protocol.codec import EncodedCommand
from gss.device.session_events import FINAL_STAGES, CommandUpdate, ReportFacts, Stage
from gss.domain.errors import Conflict, NotFound
from gss.instruments.dictionary.definitions import CommandDefinition, Values

KEPT_COMMANDS = 512
"""Number of commands kept in memory, to recognise late and repeated reports of finished commands."""

KEPT_HELLOS = 16
"""Number of unanswered HELLOs kept in memory. A line with a long delay answers a HELLO after its timeout."""

WITHDRAWN = "withdrawn"
"""Reason of a command that was withdrawn before it was sent. The device does not use this reason."""

ORDER = {s: i for i, s in enumerate((Stage.SENT, Stage.ACCEPTED, Stage.STARTED, Stage.PROGRESS))}


@dataclass
class CommandRecord:
    """One tracked command.

    ``unit``: name of the unit for which it was queued, None until a unit has identified itself. ``deadline_s``: time at which
    the current timeout expires; None if no timeout is running. ``urgent``: True if the session sends the command to every unit,
    also before the unit has identified itself (HELLO, ABORT).
    """

    request_id: int
    command: CommandDefinition
    arguments: Values
    payload: bytes
    unit: str | None = None
    stage: Stage = Stage.QUEUED
    attempt: int = 1
    deadline_s: float | None = None
    urgent: bool = False
    was_unknown: bool = field(default=False)

    def event(self, *, late: bool = False, **facts: Unpack[ReportFacts]) -> CommandUpdate:
        """Return the current stage as an event."""
        base = CommandUpdate(self.request_id, self.command.name, self.stage, attempt=self.attempt, late=late)
        # An urgent command can be sent before the unit on the line has identified itself.
        return replace(base, arguments=self.arguments, unit="" if self.urgent else self.unit or "", **facts)

    def to(
        self, stage: Stage, deadline_s: float | None = None, late: bool = False, **facts: Unpack[ReportFacts]
    ) -> CommandUpdate:
        """Change the stage and return it as an event."""
        self.stage, self.deadline_s = stage, deadline_s
        return self.event(late=late, **facts)


class CommandQueue:
    """Queue that releases one command at a time: the next one when the current command is final or unknown.

    ABORT has a separate queue.
    """

    def __init__(self) -> None:
        self._records: dict[int, CommandRecord] = {}
        self._queue: deque[CommandRecord] = deque()
        self._urgent: deque[CommandRecord] = deque()
        self._current: CommandRecord | None = None
        self._unit: str | None = None

    def add(self, request_id: int, order: EncodedCommand, *, urgent: bool = False) -> CommandUpdate:
        """Queue a command."""
        record = self._make(request_id, order)
        record.urgent = urgent
        (self._urgent if urgent else self._queue).append(record)
        return record.event()

    def add_hello(self, request_id: int, order: EncodedCommand) -> CommandUpdate:
        """Queue the session's HELLO as an urgent command, and forget old ones that were not answered."""
        name = order.command.name
        repeated = [r for r in self._records.values() if r.urgent and r.command.name == name]
        unanswered = [r for r in repeated if r.stage is Stage.UNKNOWN]
        for record in unanswered[:-KEPT_HELLOS]:
            del self._records[record.request_id]
        return self.add(request_id, order, urgent=True)

    def add_unknown(self, request_id: int, order: EncodedCommand, unit: str | None = None) -> CommandUpdate:
        """Add a command that was sent to ``unit`` before a restart; its outcome is unknown."""
        record = self._make(request_id, order)
        record.unit, record.was_unknown = unit, True
        return record.to(Stage.UNKNOWN, detail="The server restarted while the command was under way.")

    def _make(self, request_id: int, order: EncodedCommand) -> CommandRecord:
        record = CommandRecord(request_id, order.command, order.arguments, order.payload, self._unit)
        self._records[request_id] = record
        self._forget_old()
        return record

    def _forget_old(self) -> None:
        if len(self._records) > KEPT_COMMANDS:
            done = [i for i, r in self._records.items() if r.stage in FINAL_STAGES]
            for request_id in done[: len(self._records) - KEPT_COMMANDS]:
                del self._records[request_id]

    def record(self, request_id: int) -> CommandRecord | None:
        """Return the record of a request id, or None."""
        return self._records.get(request_id)

    def check_retry(self, request_id: int) -> CommandRecord:
        """Return the record of a command that can be retried. Raises NotFound for an unknown id, Conflict if the stage is not
        UNKNOWN or another unit is on the line."""
        record = self._records.get(request_id)
        if record is None:
            raise NotFound("unknown command id", got=str(request_id))
        if record.stage is not Stage.UNKNOWN:
            raise Conflict(
                "only a command whose result is unknown can be retried", expected="unknown", got=record.stage.value
            )
        if self._is_of_another_unit(record):
            raise Conflict(
                "the command was sent to another unit",
                expected=record.unit or "",
                got=self._unit or "",
                hint="mark it resolved, or retry it when its unit is back",
            )
        return record

    def _is_of_another_unit(self, record: CommandRecord) -> bool:
        return None not in (record.unit, self._unit) and record.unit != self._unit

    def retry(self, request_id: int) -> CommandUpdate:
        """Queue an unknown command again, unchanged, at the front; see ``check_retry``."""
        record = self.check_retry(request_id)
        record.attempt += 1
        self._queue.appendleft(record)
        return record.to(Stage.QUEUED)

    def withdraw(self, request_id: int, detail: str) -> CommandUpdate:
        """Withdraw a queued command: it becomes FAILED, or UNKNOWN again if it was queued for a retry."""
        record = self._records.get(request_id)
        if record is None:
            raise NotFound("unknown command id", got=str(request_id))
        if record not in self._queue:
            raise Conflict("only a queued command can be withdrawn", expected="queued", got=record.stage.value)
        self._queue.remove(record)
        if record.attempt > 1:  # an earlier attempt was sent, so its outcome is still unknown
            record.attempt -= 1
            return record.to(Stage.UNKNOWN, detail=detail)
        return record.to(Stage.FAILED, reason=WITHDRAWN, detail=detail)

    def clear(self, detail: str) -> list[CommandUpdate]:
        """Withdraw all queued commands; commands already sent are not affected."""
        return [self.withdraw(record.request_id, detail) for record in list(self._queue)]

    def identified(self, unit: str) -> list[CommandUpdate]:
        """Withdraw or lose the commands of other units after the unit with this name has identified itself.

        Queued commands are withdrawn. Commands under way become UNKNOWN; commands of unknown outcome can be retried when
        their unit is back. HELLO and ABORT continue, because they can have been sent to the new unit.
        """
        self._unit, events = unit, []
        for record in self._records.values():
            record.unit = unit if record.unit is None else record.unit
            detail = f"The unit {unit} answered, not {record.unit}."
            if record.unit == unit:
                continue
            if record in self._queue:  # also a retried ABORT
                events.append(self.withdraw(record.request_id, detail))
            elif record.deadline_s is not None and not record.urgent:
                events.append(self._lose(record, detail))
        return events

    def release(self, now_s: float, *, only_urgent: bool = False) -> tuple[list[CommandRecord], list[CommandUpdate]]:
        """Return the commands to send now, and their new stages as events."""
        records = list(self._urgent)
        self._urgent.clear()
        if self._current is None and self._queue and not only_urgent:
            self._current = self._queue.popleft()
            records.append(self._current)
        events: list[CommandUpdate] = []
        for record in records:
            events.append(record.to(Stage.RELEASED))
            events.append(record.to(Stage.SENT, now_s + record.command.accept_s))
        return records, events

    def expire(self, now_s: float) -> list[CommandUpdate]:
        """Set commands that timed out without a report to UNKNOWN and return these stages as events."""
        events = []
        for record in self._records.values():
            if record.deadline_s is not None and now_s >= record.deadline_s:
                missing = "acceptance" if record.stage is Stage.SENT else "completion"
                window_s = record.command.accept_s if record.stage is Stage.SENT else record.command.complete_s
                events.append(self._lose(record, f"No report of {missing} within {window_s:g} s."))
        return events

    def lose_all(self, detail: str) -> list[CommandUpdate]:
        """Handle the loss of the line: sent commands become unknown, queued commands stay queued.

        Urgent commands that were not sent fail: the operator does not expect an ABORT minutes later, on the next line.
        """
        unsent = [
            r.to(Stage.FAILED, reason=WITHDRAWN, detail="The line was lost before it was sent.") for r in self._urgent
        ]
        self._urgent.clear()
        return [*unsent, *(self._lose(r, detail) for r in self._records.values() if r.deadline_s is not None)]

    def _lose(self, record: CommandRecord, detail: str) -> CommandUpdate:
        record.was_unknown = True
        self._finish(record)
        return record.to(Stage.UNKNOWN, detail=detail)

    def _finish(self, record: CommandRecord) -> None:
        if self._current is record:
            self._current = None

    def report(self, request_id: int, stage: Stage, now_s: float, facts: ReportFacts) -> Sequence[CommandUpdate]:
        """Process a report of the device and return the new stages; none for a repeated or out-of-order report, or if the id is
        that of a command of another unit."""
        record = self._records.get(request_id)
        if record is None or record.stage in FINAL_STAGES:
            return ()
        if not record.urgent and self._is_of_another_unit(record):
            return ()
        if stage in ORDER and record.stage in ORDER and ORDER[stage] < ORDER[record.stage]:
            return ()
        late = record.stage is Stage.UNKNOWN
        if stage in FINAL_STAGES:
            if record in self._queue:
                self._queue.remove(record)
            self._finish(record)
            return (record.to(stage, late=late, **facts),)
        if record.stage is Stage.QUEUED:
            return ()
        deadline_s = now_s + record.command.complete_s
        return (record.to(stage, deadline_s, late, **facts),)

    @property
    def idle(self) -> bool:
        """True if no command is queued or in progress."""
        return self._current is None and not self._queue and not self._urgent

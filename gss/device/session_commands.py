"""The command lane of a host session: queue, windows, unknown, retry, abort. No bytes on the line here."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from gss.device.dictionary import Command, Dictionary, Values
from gss.device.protocol.codec import check_arguments, encode
from gss.device.session_events import FINAL_STAGES, CommandStage, Stage
from gss.domain.errors import Conflict, NotFound

KEPT_COMMANDS = 512
"""Finished commands remembered to recognise late and repeated reports."""

WITHDRAWN = "withdrawn"
"""Reason of a command that was taken back before it was sent; no word of the device."""

ORDER = {s: i for i, s in enumerate((Stage.SENT, Stage.ACCEPTED, Stage.STARTED, Stage.PROGRESS))}


@dataclass
class CommandRecord:
    """One command under way. ``deadline_s``: when its present window closes; None while none is open."""

    request_id: int
    command: Command
    payload: bytes
    stage: Stage = Stage.QUEUED
    attempt: int = 1
    deadline_s: float | None = None
    was_unknown: bool = field(default=False)

    def event(self, **facts: Any) -> CommandStage:
        """The present stage as an event."""
        base = CommandStage(self.request_id, self.command.name, self.stage, attempt=self.attempt)
        return replace(base, **facts)

    def to(self, stage: Stage, deadline_s: float | None = None, **facts: Any) -> CommandStage:
        """Go to a stage."""
        self.stage, self.deadline_s = stage, deadline_s
        return self.event(**facts)


class CommandLane:
    """Commands go out one after the other: the next is released when the one before it is final or unknown.
    ABORT has its own lane."""

    def __init__(self, dictionary: Dictionary) -> None:
        self._dictionary = dictionary
        self._records: dict[int, CommandRecord] = {}
        self._queue: deque[CommandRecord] = deque()
        self._urgent: deque[CommandRecord] = deque()
        self._current: CommandRecord | None = None

    def add(self, request_id: int, name: str, arguments: Values, *, urgent: bool = False) -> CommandStage:
        """Queue a command; BadInput and NotFound before anything changes."""
        record = self._make(request_id, name, arguments)
        (self._urgent if urgent else self._queue).append(record)
        return record.event()

    def add_unknown(self, request_id: int, name: str, arguments: Values) -> CommandStage:
        """A command of which only the sending is known, after a restart."""
        record = self._make(request_id, name, arguments)
        record.was_unknown = True
        return record.to(Stage.UNKNOWN, detail="The server restarted while the command was under way.")

    def _make(self, request_id: int, name: str, arguments: Values) -> CommandRecord:
        command = self._dictionary.command(name)
        payload = encode(command.arguments, check_arguments(command, arguments))
        record = CommandRecord(request_id, command, payload)
        self._records[request_id] = record
        self._forget_old()
        return record

    def _forget_old(self) -> None:
        if len(self._records) > KEPT_COMMANDS:
            done = [i for i, r in self._records.items() if r.stage in FINAL_STAGES]
            for request_id in done[: len(self._records) - KEPT_COMMANDS]:
                del self._records[request_id]

    def record(self, request_id: int) -> CommandRecord | None:
        """The command with that id."""
        return self._records.get(request_id)

    def retry(self, request_id: int) -> CommandStage:
        """Queue an unknown command again, unchanged, at the front."""
        record = self._records.get(request_id)
        if record is None:
            raise NotFound("unknown command id", got=str(request_id))
        if record.stage is not Stage.UNKNOWN:
            raise Conflict(
                "only a command whose fate is unknown can be retried", expected="unknown", got=record.stage.value
            )
        record.attempt += 1
        self._queue.appendleft(record)
        return record.to(Stage.QUEUED)

    def withdraw(self, request_id: int, detail: str) -> CommandStage:
        """Take a queued command back: nothing of it was sent, or nothing more of it will be."""
        record = self._records.get(request_id)
        if record is None:
            raise NotFound("unknown command id", got=str(request_id))
        if record not in self._queue:
            raise Conflict("only a queued command can be withdrawn", expected="queued", got=record.stage.value)
        self._queue.remove(record)
        if record.attempt > 1:  # it was sent before: its fate is as open as it was
            record.attempt -= 1
            return record.to(Stage.UNKNOWN, detail=detail)
        return record.to(Stage.FAILED, reason=WITHDRAWN, detail=detail)

    def clear(self, detail: str) -> list[CommandStage]:
        """Take back everything that waits; what was sent goes on."""
        return [self.withdraw(record.request_id, detail) for record in list(self._queue)]

    def abandon(self, detail: str) -> list[CommandStage]:
        """Another unit is at the other end: nothing that was meant for the one before may be sent, now or as a retry."""
        events = self.clear(detail)
        for request_id in [i for i, r in self._records.items() if r.stage is Stage.UNKNOWN]:
            del self._records[request_id]
        return events

    def release(self, now_s: float, *, only_urgent: bool = False) -> tuple[list[CommandRecord], list[CommandStage]]:
        """Commands to write now, with their stages."""
        records = list(self._urgent)
        self._urgent.clear()
        if self._current is None and self._queue and not only_urgent:
            self._current = self._queue.popleft()
            records.append(self._current)
        events: list[CommandStage] = []
        for record in records:
            events.append(record.to(Stage.RELEASED))
            events.append(record.to(Stage.SENT, now_s + record.command.accept_s))
        return records, events

    def expire(self, now_s: float) -> list[CommandStage]:
        """Windows that closed without a report."""
        events = []
        for record in self._records.values():
            if record.deadline_s is not None and now_s >= record.deadline_s:
                missing = "acceptance" if record.stage is Stage.SENT else "completion"
                window_s = record.command.accept_s if record.stage is Stage.SENT else record.command.complete_s
                events.append(self._lose(record, f"No report of {missing} within {window_s:g} s."))
        return events

    def lose_all(self, detail: str) -> list[CommandStage]:
        """The line is gone: what was sent is unknown, what was queued stays queued. Urgent commands that were not sent end here: an
        ABORT that leaves on the next line, minutes later, is not what was asked for."""
        unsent = [
            r.to(Stage.FAILED, reason=WITHDRAWN, detail="The line was lost before it was sent.") for r in self._urgent
        ]
        self._urgent.clear()
        return [*unsent, *(self._lose(r, detail) for r in self._records.values() if r.deadline_s is not None)]

    def _lose(self, record: CommandRecord, detail: str) -> CommandStage:
        record.was_unknown = True
        self._finish(record)
        return record.to(Stage.UNKNOWN, detail=detail)

    def _finish(self, record: CommandRecord) -> None:
        if self._current is record:
            self._current = None

    def report(self, request_id: int, stage: Stage, now_s: float, facts: dict[str, Any]) -> Sequence[CommandStage]:
        """A report of the device. A repeated or overtaken one brings nothing new."""
        record = self._records.get(request_id)
        if record is None or record.stage in FINAL_STAGES:
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
        return (record.to(stage, deadline_s=deadline_s, late=late, **facts),)

    @property
    def idle(self) -> bool:
        """Nothing queued and nothing under way."""
        return self._current is None and not self._queue and not self._urgent

"""Scheduled commands: stored in the flash record; the command processor checks and runs them at their device time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from gss.device.protocol.codec import decode, fixed_bytes
from gss.device.simulator.command_processor import Arguments, CommandProcessor, Handler, Returns
from gss.device.simulator.flash_record import ScheduleEntry
from gss.device.simulator.memory import Memory
from gss.device.simulator.outbox import Outbox
from gss.device.simulator.rejection import Rejection
from gss.device.simulator.reports import Report
from gss.domain.errors import BadInput, CorruptData
from gss.instruments.dictionary.checked_values import check_arguments
from gss.instruments.dictionary.definitions import Dictionary

MAX_WAITING = 16
MAX_ENDED = 16
NEVER = ("HELLO", "SCHEDULE", "ABORT")
"""Commands that cannot be scheduled."""


class Schedule:
    """Handlers and execution of the schedule. ``time_s``: returns the device time."""

    def __init__(
        self,
        dictionary: Dictionary,
        memory: Memory,
        outbox: Outbox,
        processor: CommandProcessor,
        time_s: Callable[[], float],
    ) -> None:
        self._dictionary, self._memory, self._outbox, self._processor, self._time_s = (
            dictionary,
            memory,
            outbox,
            processor,
            time_s,
        )

    def handlers(self) -> dict[str, Handler]:
        """Return the handlers by command name."""
        return {"SCHEDULE": self.schedule, "LIST_SCHEDULE": self.list_schedule, "CANCEL": self.cancel}

    @property
    def waiting(self) -> list[ScheduleEntry]:
        """Waiting entries, sorted by time."""
        entries = [e for e in self._memory.record.schedule if e.state == "waiting"]
        return sorted(entries, key=lambda e: (e.at_s, e.schedule_id))

    # --- commands -----------------------------------------------------------------------------------------------

    def schedule(self, arguments: Arguments, request_id: int) -> Returns:
        at_s, length, payload = float(arguments["at_s"]), int(arguments["length"]), bytes(arguments["payload"])  # type: ignore[arg-type]  # bytes decode to bytes
        self._check(int(arguments["command_code"]), payload[:length])
        if at_s <= self._time_s():
            raise Rejection(
                "out_of_range", f"the device time is already {self._time_s():.1f} s, requested {at_s:.1f} s"
            )
        if len(self.waiting) >= MAX_WAITING:
            raise Rejection("schedule_full", f"{MAX_WAITING} commands are already waiting")
        record = self._memory.record
        entry = ScheduleEntry(
            record.next_schedule, at_s, int(arguments["command_code"]), payload[:length].hex(), request_id
        )
        record.next_schedule += 1
        record.schedule.append(entry)
        self._memory.save()
        self._outbox.telemetry(_report(entry), request_id)
        return {"schedule_id": entry.schedule_id}

    def _check(self, code: int, payload: bytes) -> None:
        """Raise Rejection unless the bytes are a valid command. Its preconditions are checked when it runs."""
        command = self._dictionary.command_of_code(code)
        if command is None or command.name not in self._processor.handlers:
            raise Rejection("unknown_command", f"code {code}")
        if command.name in NEVER:
            raise Rejection("wrong_state", f"{command.name} cannot be scheduled")
        if len(payload) != fixed_bytes(command.arguments):
            raise Rejection("bad_length", f"{command.name} has {fixed_bytes(command.arguments)} B, got {len(payload)}")
        try:
            check_arguments(command, decode(command.arguments, payload).values)
        except (BadInput, CorruptData) as error:
            raise Rejection("out_of_range", error.message) from error

    def list_schedule(self, _: Arguments, request_id: int) -> Returns:
        entries = self._memory.record.schedule
        for entry in entries:
            self._outbox.telemetry(_report(entry), request_id)
        return {"count": len(entries)}

    def cancel(self, arguments: Arguments, request_id: int) -> Returns:
        schedule_id = int(arguments["schedule_id"])
        chosen = [e for e in self.waiting if schedule_id in (0, e.schedule_id)]
        if schedule_id and not chosen:
            raise Rejection("not_found", f"no waiting command has number {schedule_id}")
        for entry in chosen:
            self._put(replace(entry, state="cancelled"), request_id)
        return {"count": len(chosen)}

    # --- execution ----------------------------------------------------------------------------------------------

    def restart(self, time_s: float) -> None:
        """Restart at the end of a boot, at a device time: report commands that the reset interrupted, and commands whose time
        passed while the processor was not running."""
        for entry in list(self._memory.record.schedule):
            if entry.running:
                self._ended(replace(entry, running=False), "failed", "reset", "the device restarted during the command")
        for entry in self.waiting:
            if entry.at_s <= time_s:
                self._put(replace(entry, state="missed"), entry.request_id)
                self._outbox.event("SCHEDULE_FAILED", f"{self._name(entry)} was missed", entry.request_id)

    def advance(self) -> None:
        """Run each due command once. A command can cancel the next one."""
        while self.waiting and self.waiting[0].at_s <= self._time_s():
            entry = self.waiting[0]
            # The entry is marked as failed before it runs. After a reset it therefore remains failed, and no command
            # runs twice.
            self._put(replace(entry, state="failed", reason="reset", running=True), 0, report=False)
            self._processor.run_scheduled(
                entry.request_id,
                entry.command_code,
                bytes.fromhex(entry.payload),
                partial(self._ended, entry),
            )

    def _ended(self, entry: ScheduleEntry, stage: str, reason: str, detail: str) -> None:
        name = self._name(entry)
        if stage == "completed":
            self._put(replace(entry, state="done"), entry.request_id)
            self._outbox.event("SCHEDULE_RUN", name, entry.request_id)
        else:
            self._put(replace(entry, state="failed", reason=reason), entry.request_id)
            self._outbox.event("SCHEDULE_FAILED", f"{name}: {reason}, {detail}".rstrip(", "), entry.request_id)

    def _name(self, entry: ScheduleEntry) -> str:
        command = self._dictionary.command_of_code(entry.command_code)
        return f"{command.name if command else entry.command_code} (schedule {entry.schedule_id})"

    def _put(self, entry: ScheduleEntry, request_id: int, *, report: bool = True) -> None:
        """Replace an entry. Of the ended entries, only the last ``MAX_ENDED`` are kept."""
        record = self._memory.record
        entries = [entry if e.schedule_id == entry.schedule_id else e for e in record.schedule]
        ended = [e.schedule_id for e in entries if e.state != "waiting"]
        forgotten = set(ended[: max(0, len(ended) - MAX_ENDED)])
        record.schedule = [e for e in entries if e.schedule_id not in forgotten]
        self._memory.save()
        if report:
            self._outbox.telemetry(_report(entry), request_id)


def _report(entry: ScheduleEntry) -> Report:
    payload = bytes.fromhex(entry.payload)
    values: Returns = {
        "schedule_id": entry.schedule_id,
        "at_s": entry.at_s,
        "command_code": entry.command_code,
        "length": len(payload),
        "payload": payload.ljust(64, b"\0"),
        "state": entry.state,
        "reason": entry.reason,
    }
    return "schedule_entry", values, {}

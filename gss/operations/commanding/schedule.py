"""On-board schedule: schedule, list and cancel commands that the device executes at a later UTC or device time."""

from __future__ import annotations

import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from gss.device.session_events import (
    CommandUpdate,
    DeviceEvent,
    HelloReceived,
    Stage,
    Telemetry,
)
from gss.domain.errors import BadInput, Conflict, NotFound
from gss.instruments.dictionary.definitions import Hazard, Value
from gss.instruments.operations import COMMAND_CODE, LENGTH, PAYLOAD, SCHEDULE_ID, Operation
from gss.operations.clock import Now, iso_z
from gss.operations.commanding.command_checks import risk_of, scheduled
from gss.operations.commanding.commanding import CommandService
from gss.operations.commanding.schedule_plan import Plan, make_plan, moment_of
from gss.operations.events import EventBus
from gss.operations.line.clock_correlation import ClockTracker, Correlation
from gss.operations.line.line_events import LineBatch
from gss.operations.line.link import LinkService
from gss.store.models import Command


@dataclass(frozen=True)
class Entry:
    """One row of the device's schedule. ``at`` (UTC) and ``uncertainty_s`` are None if the clocks are not correlated.
    ``command`` is None if the bytes cannot be decoded with the host's dictionary."""

    schedule_id: int
    at_device_s: float
    at: datetime | None
    uncertainty_s: float | None
    command: str | None
    arguments: Mapping[str, Value]
    hazard: Hazard
    state: str
    reason: str
    payload: bytes


@dataclass(frozen=True)
class ScheduleState:
    """The device's schedule in order of time. ``listed_at``: time of the last list from the device. ``complete``: True if no row
    of that list was lost. ``clock``: correlation of the device's clock with UTC, None if unknown."""

    entries: Sequence[Entry]
    listed_at: datetime | None
    complete: bool
    clock: Correlation | None


class ScheduleService:
    """Stores the device's last reported schedule and the correlation of the clocks, and sends schedule commands."""

    def __init__(self, link: LinkService, commands: CommandService, bus: EventBus, now: Now) -> None:
        self._link, self._commands, self._bus, self._now = link, commands, bus, now
        events = link.roles.events
        self._clock_events = (events.boot, events.time_set, events.clock_jump)
        self._table_events = (events.schedule_run, events.schedule_failed, events.boot)
        self._clock = ClockTracker()
        self._rows: dict[int, Mapping[str, Value]] = {}
        self._listing: dict[int, dict[int, Mapping[str, Value]]] = {}
        self._listed_at: datetime | None = None
        self._complete = False
        self._lock = threading.Lock()

    # --- reports from the device --------------------------------------------------------------------------------

    def handle(self, batch: LineBatch) -> None:
        """Update the clock correlation and the schedule. Request the list from the device if the schedule changed."""
        needs_list = changed = False
        for event in batch.events:
            if isinstance(event, Telemetry):
                changed |= self._packet(event, batch.at)
            elif isinstance(event, HelloReceived):
                self._forget()
                needs_list, changed = event.dictionary_match, True
            elif isinstance(event, DeviceEvent):
                if event.name in self._clock_events:
                    with self._lock:
                        self._clock.restart()
                needs_list |= event.name in self._table_events
            elif isinstance(event, CommandUpdate) and event.stage is Stage.COMPLETED:
                operation = self._link.roles.operations.of_command(event.name, event.arguments)
                needs_list |= operation in (Operation.SCHEDULE, Operation.CANCEL_SCHEDULED)
                changed |= operation is Operation.LIST_SCHEDULE and self._listed(event)
        if changed:
            self._bus.publish("schedule", self.state())
        if needs_list:
            self._request_list()

    def _packet(self, packet: Telemetry, at: datetime) -> bool:
        roles = self._link.roles.quantities
        with self._lock:
            if packet.packet == roles.status.packet and packet.device_time_s:
                self._clock.add(at.timestamp(), packet.device_time_s)
            if packet.packet != roles.schedule_entry.packet:
                return False
            number = int(packet.values[roles.schedule_entry.schedule_id])
            self._rows[number] = packet.values
            if packet.request_id:
                self._listing.setdefault(packet.request_id, {})[number] = packet.values
            return True

    def _listed(self, event: CommandUpdate) -> bool:
        """Replace the schedule with the received list if the list is complete. Rows that are not in the list no longer exist."""
        with self._lock:
            rows = self._listing.get(event.request_id, {})
            self._listing.clear()
            self._complete = len(rows) == int(event.values["count"])
            if self._complete:
                self._rows = rows
            self._listed_at = self._now()
        return True

    def _forget(self) -> None:
        with self._lock:
            self._rows, self._listing = {}, {}
            self._listed_at, self._complete = None, False
            self._clock.restart()

    def _request_list(self) -> None:
        operations = self._link.roles.operations
        if operations.has(Operation.LIST_SCHEDULE):
            self._commands.query(operations.command(Operation.LIST_SCHEDULE))

    def clock_jumped(self, _jump_s: float) -> None:
        """Discard the clock correlation after a jump of the server's clock. An old correlation would be wrong until
        enough new packets have arrived."""
        with self._lock:
            self._clock.restart()

    # --- queries ------------------------------------------------------------------------------------------------

    def clock(self) -> Correlation | None:
        """Return the clock correlation, None before enough packets have arrived."""
        with self._lock:
            return self._clock.estimate()

    def state(self) -> ScheduleState:
        """Return the last reported schedule and the clock correlation. Nothing is sent."""
        with self._lock:
            clock, rows = self._clock.estimate(), list(self._rows.values())
            listed_at, complete = self._listed_at, self._complete
        entries = sorted((self._entry(row, clock) for row in rows), key=lambda e: (e.at_device_s, e.schedule_id))
        return ScheduleState(entries, listed_at, complete, clock)

    def _entry(self, row: Mapping[str, Any], clock: Correlation | None) -> Entry:
        names, operations = self._link.roles.quantities.schedule_entry, self._link.roles.operations
        at_device_s = float(row[names.at_s])
        payload, length = row[names.payload], int(row[names.length])
        at, uncertainty_s = moment_of(clock, at_device_s)
        values = {COMMAND_CODE: row[names.command_code], PAYLOAD: payload, LENGTH: length}
        inner = scheduled(operations.dictionary, values)
        risk = risk_of(operations, *inner) if inner else None
        return Entry(
            schedule_id=int(row[names.schedule_id]),
            at_device_s=at_device_s,
            at=at,
            uncertainty_s=uncertainty_s,
            command=inner[0].name if inner else None,
            arguments=inner[1] if inner else {},
            hazard=risk.hazard if risk else Hazard.NONE,
            state=str(row[names.state]),
            reason="" if row[names.reason] == "none" else str(row[names.reason]),
            payload=bytes(payload)[:length],
        )

    # --- orders -------------------------------------------------------------------------------------------------

    def plan(self, name: str, arguments: Mapping[str, Any], *, at: datetime | None, at_device_s: float | None) -> Plan:
        """Return the plan for scheduling a command: the arguments of SCHEDULE, the problems and the warnings. Does not
        send anything."""
        now_s = self._now().timestamp()
        return make_plan(
            self._link.roles.operations, self.clock(), now_s, name, arguments, at=at, at_device_s=at_device_s
        )

    def command(self) -> str:
        """Return the name of the command that schedules another command on board. Raises Conflict if the sensor does not have
        one."""
        return self._link.roles.operations.command(Operation.SCHEDULE)

    def send(
        self,
        name: str,
        arguments: Mapping[str, Any],
        *,
        at: datetime | None,
        at_device_s: float | None,
        confirm: str,
        user: str,
    ) -> Command:
        """Schedule a command on board and return the row of the SCHEDULE command. Raises BadInput if the plan has problems."""
        plan = self.plan(name, arguments, at=at, at_device_s=at_device_s)
        if plan.problems:
            raise BadInput(f"{name} cannot be scheduled: {plan.problems[0]}", got="; ".join(plan.problems[1:]))
        row = self._commands.send(self.command(), plan.order, confirm=confirm, user=user, source="schedule")
        when = iso_z(plan.at) if plan.at else "unknown UTC time"
        text = f"{user} schedules {name} for device time {plan.at_device_s:.3f} s, {when}"
        self._bus.record("schedule", "ok", text, command_id=row.id)
        return row

    def cancel(self, schedule_id: int, *, user: str) -> Command:
        """Cancel one scheduled command. Raises NotFound if it does not exist, Conflict if it is no longer waiting."""
        entries = {entry.schedule_id: entry for entry in self.state().entries}
        if schedule_id not in entries:
            hint = "refresh the list"
            raise NotFound("no scheduled command has this number", got=str(schedule_id), hint=hint)
        entry = entries[schedule_id]
        if entry.state != "waiting":
            raise Conflict("only waiting commands can be cancelled", expected="waiting", got=entry.state)
        row = self._cancel(schedule_id, user)
        self._bus.record("schedule", "ok", f"{user} cancels {entry.command or 'an unknown command'}, {schedule_id}")
        return row

    def cancel_all(self, *, user: str) -> Command:
        """Cancel all scheduled commands that are waiting, including commands that are not in the last list."""
        row = self._cancel(0, user)
        self._bus.record("schedule", "watch", f"{user} cancels all scheduled commands")
        return row

    def _cancel(self, schedule_id: int, user: str) -> Command:
        call = self._link.roles.operations.call(Operation.CANCEL_SCHEDULED, {SCHEDULE_ID: schedule_id})
        return self._commands.send(call.command, call.arguments, confirm="", user=user, source="schedule")

    def refresh(self, *, user: str) -> Command:
        """Request the schedule from the device."""
        name = self._link.roles.operations.command(Operation.LIST_SCHEDULE)
        return self._commands.send(name, {}, confirm="", user=user, source="schedule")

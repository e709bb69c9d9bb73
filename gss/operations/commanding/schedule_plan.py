"""Preparation of the arguments of SCHEDULE for a command at a given time, with problems and warnings. Nothing is sent."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from gss.device.protocol.codec import encode_command
from gss.domain.errors import BadInput, GssError
from gss.instruments.dictionary.definitions import CommandDefinition, Value
from gss.instruments.operations import AT_S, COMMAND_CODE, LENGTH, PAYLOAD, Operation, StandardOperations
from gss.operations.commanding.command_checks import Risk, risk_of
from gss.operations.line.clock_correlation import Correlation

NEVER = {
    Operation.ABORT: "ABORT must take effect immediately",
    Operation.HELLO: "HELLO is sent by the ground only",
    Operation.SCHEDULE: "schedule commands cannot be scheduled",
    Operation.LIST_SCHEDULE: "the reply would arrive without a request",
    Operation.CANCEL_SCHEDULED: "use CANCEL now instead",
}
CONFIRMED_BY = {Operation.ACTIVATE: Operation.CONFIRM, Operation.ACTIVATE_TABLE: Operation.CONFIRM_TABLE}
CLOSE_S = 5.0
ROUGH_S = 1.0


@dataclass(frozen=True)
class Plan:
    """A checked command for later execution. ``order``: arguments of SCHEDULE; empty if there are problems."""

    problems: tuple[str, ...]
    warnings: tuple[str, ...]
    at_device_s: float | None
    at: datetime | None
    uncertainty_s: float | None
    risk: Risk
    role: str
    order: Mapping[str, Value]


def schedulable(operations: StandardOperations, command: CommandDefinition) -> bool:
    """True if the command can be scheduled on board, with all or some of its arguments."""
    rows = [operations.require(operation) for operation in NEVER if operations.has(operation)]
    never = any(row.command == command.name and not row.fixed for row in rows)
    return not never and not command.simulator_only


def make_plan(
    operations: StandardOperations,
    clock: Correlation | None,
    now_s: float,
    name: str,
    arguments: Mapping[str, Any],
    *,
    at: datetime | None,
    at_device_s: float | None,
) -> Plan:
    """Plan the command ``name`` for a time in UTC (``at``) or device time (``at_device_s``). ``clock``: correlation of the clocks,
    None if unknown. ``now_s``: current UTC as Unix time."""
    inner = operations.dictionary.command(name)
    problems, warnings = _not_schedulable(operations, inner, arguments), list(_warnings(operations, inner, arguments))
    if (at is None) == (at_device_s is None):
        problems.append("enter either a UTC time or a device time")
    elif at is not None and clock is not None:
        at_device_s = round(clock.device_of(at.timestamp()), 3)
    elif at is not None:
        problems.append("device clock offset unknown. Wait for telemetry, or enter a device time")
    moment, uncertainty_s = moment_of(clock, at_device_s)
    if at_device_s is not None:
        device_now_s = None if clock is None else clock.device_of(now_s)
        problems += _past(at_device_s, device_now_s)
        warnings += _close(at_device_s, device_now_s, uncertainty_s)
    order: dict[str, Value] = {}
    try:
        order = _order(operations, inner, arguments, at_device_s or 0.0)
    except GssError as error:
        problems.append(str(error))
    risk = risk_of(operations, operations.dictionary.command(operations.command(Operation.SCHEDULE)), order)
    ready = order if not problems else {}
    return Plan(tuple(problems), tuple(warnings), at_device_s, moment, uncertainty_s, risk, inner.role, ready)


def _not_schedulable(
    operations: StandardOperations, inner: CommandDefinition, arguments: Mapping[str, Any]
) -> list[str]:
    operation = operations.of_command(inner.name, arguments)
    if operation in NEVER:
        return [NEVER[operation]]
    return ["commands of the simulator are not scheduled"] if inner.simulator_only else []


def _past(at_device_s: float, now_s: float | None) -> list[str]:
    if now_s is None or at_device_s > now_s:
        return []
    return [f"the time is in the past: device clock {now_s:.3f} s, requested {at_device_s:.3f} s"]


def _close(at_device_s: float, now_s: float | None, uncertainty_s: float | None) -> list[str]:
    if now_s is None or uncertainty_s is None:
        return ["device clock offset unknown: the time may be in the past"]
    left_s = at_device_s - now_s
    warnings = []
    if 0 < left_s < CLOSE_S + uncertainty_s:
        warnings.append(f"due in {left_s:.1f} s: it may arrive too late")
    if uncertainty_s > ROUGH_S:
        warnings.append(f"UTC time is uncertain by ± {uncertainty_s:.1f} s")
    return warnings


def _order(
    operations: StandardOperations, inner: CommandDefinition, arguments: Mapping[str, Any], at_device_s: float
) -> dict[str, Value]:
    payload = encode_command(inner, arguments).payload
    schedule = operations.dictionary.command(operations.command(Operation.SCHEDULE))
    max_bytes = schedule.argument(operations.argument(Operation.SCHEDULE, PAYLOAD)).size
    if len(payload) > max_bytes:
        raise BadInput(f"{inner.name} is too long", expected=f"at most {max_bytes} bytes", got=str(len(payload)))
    values: dict[str, Value] = {
        AT_S: at_device_s,
        COMMAND_CODE: inner.code,
        LENGTH: len(payload),
        PAYLOAD: payload.ljust(max_bytes, b"\0").hex(),
    }
    return operations.call(Operation.SCHEDULE, values).arguments


def moment_of(clock: Correlation | None, device_s: float | None) -> tuple[datetime | None, float | None]:
    """Return the UTC of a device time and its uncertainty in seconds, (None, None) if unknown."""
    if clock is None or device_s is None:
        return None, None
    utc_s = clock.utc_of(device_s)
    try:
        return datetime.fromtimestamp(utc_s, UTC), clock.uncertainty_at(utc_s)
    except (ValueError, OverflowError, OSError):
        return None, None  # the time is outside the range of datetime


def _warnings(operations: StandardOperations, inner: CommandDefinition, arguments: Mapping[str, Any]) -> list[str]:
    warnings = [f"checked on board at execution: {c.text}" for c in inner.preconditions]
    operation = operations.of_command(inner.name, arguments)
    if operation is Operation.RESET:
        warnings.insert(0, "the device restarts unattended and loses image memory")
    if operation in CONFIRMED_BY:
        warnings.insert(
            0, f"{operations.command(CONFIRMED_BY[operation])} must follow in time, or the device falls back"
        )
    return warnings

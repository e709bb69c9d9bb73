"""Prepares the arguments of SCHEDULE for a command at a given time, with problems and warnings. Nothing is sent."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any

from gss.device.dictionary import Command, Dictionary, Value
from gss.device.protocol.codec import check_arguments, encode
from gss.domain.errors import BadInput, GssError
from gss.operations.commanding.command_checks import SCHEDULE, Risk, risk_of
from gss.operations.line.clock_correlation import Correlation

NEVER = {
    "ABORT": "ABORT acts at once or not at all",
    "HELLO": "HELLO is a question of the ground",
    SCHEDULE: "a schedule holds no schedules",
    "LIST_SCHEDULE": "a list that nobody asked for is of no use",
    "CANCEL": "cancel it now instead",
}
CLOSE_S = 5.0
ROUGH_S = 1.0


@dataclass(frozen=True)
class Plan:
    """A checked command for later execution. ``order``: arguments of SCHEDULE, empty if there are problems."""

    problems: tuple[str, ...]
    warnings: tuple[str, ...]
    at_device_s: float | None
    at: datetime | None
    uncertainty_s: float | None
    risk: Risk
    role: str
    order: Mapping[str, Value]


def schedulable(command: Command) -> bool:
    """True if the command may be put into the device's schedule."""
    return command.name not in NEVER and not command.simulator_only


def make_plan(
    dictionary: Dictionary,
    clock: Correlation | None,
    now_s: float,
    name: str,
    arguments: Mapping[str, Any],
    *,
    at: datetime | None,
    at_device_s: float | None,
) -> Plan:
    """Plan the command ``name`` for a time given either in UTC or in device time. ``clock``: None while not correlated;
    ``now_s``: UTC as Unix time."""
    inner = dictionary.command(name)
    problems, warnings = _not_schedulable(inner), list(_warnings(inner))
    if (at is None) == (at_device_s is None):
        problems.append("give the time either in UTC or in device time")
    elif at is not None and clock is not None:
        at_device_s = round(clock.device_of(at.timestamp()), 3)
    elif at is not None:
        problems.append("the device's clock is not correlated with UTC yet: wait for telemetry, or give device time")
    moment, uncertainty_s = moment_of(clock, at_device_s)
    if at_device_s is not None:
        device_now_s = None if clock is None else clock.device_of(now_s)
        problems += _past(at_device_s, device_now_s)
        warnings += _close(at_device_s, device_now_s, uncertainty_s)
    order: dict[str, Value] = {}
    try:
        order = _order(dictionary, inner, arguments, at_device_s or 0.0)
    except GssError as error:
        problems.append(str(error))
    risk = risk_of(dictionary, dictionary.command(SCHEDULE), order)
    ready = order if not problems else {}
    return Plan(tuple(problems), tuple(warnings), at_device_s, moment, uncertainty_s, risk, inner.role, ready)


def _not_schedulable(inner: Command) -> list[str]:
    if inner.name in NEVER:
        return [NEVER[inner.name]]
    return ["commands of the simulator are not scheduled"] if inner.simulator_only else []


def _past(at_device_s: float, now_s: float | None) -> list[str]:
    if now_s is None or at_device_s > now_s:
        return []
    return [f"the time is past: the device's clock shows {now_s:.3f} s, asked for {at_device_s:.3f} s"]


def _close(at_device_s: float, now_s: float | None, uncertainty_s: float | None) -> list[str]:
    if now_s is None or uncertainty_s is None:
        return ["whether the time is past is not known: the clocks are not correlated yet"]
    left_s = at_device_s - now_s
    words = []
    if 0 < left_s < CLOSE_S + uncertainty_s:
        words.append(f"in {left_s:.1f} s already: it may arrive after its time")
    if uncertainty_s > ROUGH_S:
        words.append(f"the moment is only known to ± {uncertainty_s:.1f} s of UTC")
    return words


def _order(
    dictionary: Dictionary, inner: Command, arguments: Mapping[str, Any], at_device_s: float
) -> dict[str, Value]:
    payload = encode(inner.arguments, check_arguments(inner, arguments))
    room = dictionary.command(SCHEDULE).argument("payload").size
    if len(payload) > room:
        raise BadInput(f"{inner.name} is too long", expected=f"at most {room} bytes", got=str(len(payload)))
    order: dict[str, Value] = {"at_s": at_device_s, "command_code": inner.code, "length": len(payload)}
    return order | {"payload": payload.ljust(room, b"\0").hex()}


def moment_of(clock: Correlation | None, device_s: float | None) -> tuple[datetime | None, float | None]:
    """Return UTC of a device time and its uncertainty in seconds; (None, None) if unknown."""
    if clock is None or device_s is None:
        return None, None
    utc_s = clock.utc_of(device_s)
    try:
        return datetime.fromtimestamp(utc_s, UTC), clock.uncertainty_at(utc_s)
    except (ValueError, OverflowError, OSError):
        return None, None  # outside the calendar's range


def _warnings(inner: Command) -> list[str]:
    words = [f"checked on board when the time comes: {c.text}" for c in inner.preconditions]
    if inner.name == "RESET":
        words.insert(0, "the device restarts unattended, and image memory is lost")
    if inner.name.startswith("ACTIVATE_"):
        confirm = inner.name.replace("ACTIVATE", "CONFIRM")
        words.insert(0, f"{confirm} must follow in time, or the device falls back")
    return words

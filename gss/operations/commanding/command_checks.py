"""Checks before a command is sent: preconditions, hazards, confirmation, simulator-only commands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from gss.device.dictionary import Command, Dictionary, Hazard, Value
from gss.device.protocol.codec import decode
from gss.device.session_events import HelloReceived
from gss.domain.errors import BadInput, Conflict, GssError

YES = "yes"
SCHEDULE = "SCHEDULE"


@dataclass(frozen=True)
class PreconditionState:
    """A precondition, whether it is met (None: not known), and the value that decides it."""

    text: str
    met: bool | None
    value: str


@dataclass(frozen=True)
class Risk:
    """The hazard of a command with its arguments, the reason, and the name to type as confirmation."""

    hazard: Hazard
    reason: str
    name: str

    @property
    def needs_confirmation(self) -> bool:
        """True if the operator must confirm or type the name."""
        return self.hazard in (Hazard.WARNING, Hazard.CRITICAL)


@dataclass(frozen=True)
class Check:
    """Result of a dry run. ``groups``: (label, bytes) of the packet before framing; empty if the arguments are invalid.
    ``holder``: of command authority. ``problems``: reasons why it cannot be sent; a missing confirmation is not one."""

    problems: tuple[str, ...]
    preconditions: tuple[PreconditionState, ...]
    groups: tuple[tuple[str, bytes], ...]
    risk: Risk
    role: str
    idempotent: bool
    holder: str | None


def risk_of(dictionary: Dictionary, command: Command, arguments: Mapping[str, Any]) -> Risk:
    """Return the higher of the hazards of the command and of its argument values; for SCHEDULE, also of the command that it
    carries."""
    hazard, reason = command.hazard_for(arguments)
    own = Risk(hazard, reason, command.name)
    inner = scheduled(dictionary, arguments) if command.name == SCHEDULE else None
    if inner is None:
        return own
    carried = risk_of(dictionary, *inner)
    if carried.hazard.rank > own.hazard.rank:
        return Risk(carried.hazard, f"When its time comes: {carried.reason}", carried.name)
    return own


def subsystems_of(dictionary: Dictionary, command: Command, arguments: Mapping[str, Any]) -> frozenset[str]:
    """Return the subsystems a command belongs to: its own and, for SCHEDULE, that of the command it carries. If the carried
    command cannot be decoded, all subsystems, so that raw bytes cannot bypass permissions."""
    if command.name != SCHEDULE:
        return frozenset({command.subsystem})
    inner = scheduled(dictionary, arguments)
    carried = subsystems_of(dictionary, *inner) if inner else frozenset(c.subsystem for c in dictionary.commands)
    return carried | {command.subsystem}


def scheduled(dictionary: Dictionary, arguments: Mapping[str, Any]) -> tuple[Command, dict[str, Value]] | None:
    """Decode the command that SCHEDULE (or a schedule_entry) carries, with its arguments; None if it cannot be decoded."""
    try:
        command = dictionary.command_of_code(int(arguments["command_code"]))
        payload = arguments["payload"]
        data = bytes.fromhex(payload) if isinstance(payload, str) else bytes(payload)
        if command is None:
            return None
        return command, decode(command.arguments, data[: int(arguments["length"])]).values
    except (GssError, KeyError, ValueError, TypeError):
        return None


def check_confirmation(risk: Risk, confirm: str) -> None:
    """Raise BadInput unless a critical command is confirmed by its typed name, or a warning one by "yes" or its name."""
    if risk.hazard is Hazard.CRITICAL and confirm != risk.name:
        raise BadInput(f"{risk.name} is critical and was not confirmed", expected=f"the name {risk.name} typed")
    if risk.hazard is Hazard.WARNING and confirm not in (YES, risk.name):
        raise BadInput(f"{risk.name} was not confirmed", expected="a yes: " + risk.reason)


def precondition_states(command: Command, housekeeping: Mapping[str, Value] | None) -> tuple[PreconditionState, ...]:
    """Return the current state of each precondition of a command."""
    states = []
    for condition in command.preconditions:
        value = None if housekeeping is None else housekeeping.get(condition.field)
        states.append(PreconditionState(condition.text, condition.met(housekeeping), _now(condition.field, value)))
    return tuple(states)


def _now(field: str, value: Value | None) -> str:
    """Return the value as text; for a flag, its own name: "running" or "not running" for ``cycle_running``."""
    if isinstance(value, bool):
        return ("" if value else "not ") + field.rsplit("_", 1)[-1]
    return words(value)


def check_unit(command: Command, hello: HelloReceived | None) -> None:
    """Raise Conflict if a simulator-only command would go to a device that does not report itself as simulated."""
    if not command.simulator_only or (hello is not None and hello.simulated):
        return
    got = "no device has answered yet" if hello is None else f"{hello.serial or hello.device_model} is real"
    raise Conflict(f"{command.name} is for simulators only", expected="a simulated device", got=got)


def words(value: Any) -> str:
    """Return a telemetry value as display text."""
    if value is None:
        return "not received"
    return {True: "yes", False: "no"}[value] if isinstance(value, bool) else str(value).replace("_", " ")

"""Checks before a command is sent: preconditions, hazards, confirmation, simulator-only commands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from gss.device.protocol.codec import decode
from gss.device.session_events import HelloReceived
from gss.domain.errors import BadInput, Conflict, GssError
from gss.instruments.dictionary.definitions import CommandDefinition, Dictionary, Hazard, Value
from gss.instruments.operations import COMMAND_CODE, LENGTH, PAYLOAD, Operation, StandardOperations

YES = "yes"


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
class DryRun:
    """Result of a dry run. ``groups``: (label, bytes) of the packet before framing; empty if the arguments are invalid.
    ``holder``: of command authority. ``problems``: reasons why it cannot be sent; a missing confirmation is not one."""

    problems: tuple[str, ...]
    preconditions: tuple[PreconditionState, ...]
    groups: tuple[tuple[str, bytes], ...]
    risk: Risk
    role: str
    idempotent: bool
    holder: str | None


def risk_of(operations: StandardOperations, command: CommandDefinition, arguments: Mapping[str, Any]) -> Risk:
    """Return the higher of the hazards of the command and of its argument values; for SCHEDULE, also of the command that it
    carries."""
    hazard, reason = command.hazard_for(arguments)
    direct = Risk(hazard, reason, command.name)
    inner = _carried(operations, command, arguments)
    if inner is None:
        return direct
    carried = risk_of(operations, *inner)
    if carried.hazard.rank > direct.hazard.rank:
        return Risk(carried.hazard, f"At execution: {carried.reason}", carried.name)
    return direct


def subsystems_of(
    operations: StandardOperations, command: CommandDefinition, arguments: Mapping[str, Any]
) -> frozenset[str]:
    """Return the subsystems a command belongs to: its own and, for SCHEDULE, that of the command it carries. If the carried
    command cannot be decoded, all subsystems, so that raw bytes cannot bypass permissions."""
    if operations.of_command(command.name) is not Operation.SCHEDULE:
        return frozenset({command.subsystem})
    inner = _carried(operations, command, arguments)
    carried = (
        subsystems_of(operations, *inner) if inner else frozenset(c.subsystem for c in operations.dictionary.commands)
    )
    return carried | {command.subsystem}


def _carried(
    operations: StandardOperations, command: CommandDefinition, arguments: Mapping[str, Any]
) -> tuple[CommandDefinition, dict[str, Value]] | None:
    """Return the command that SCHEDULE carries; None for any other command."""
    if operations.of_command(command.name) is not Operation.SCHEDULE:
        return None
    return scheduled(operations.dictionary, operations.given(Operation.SCHEDULE, arguments))


def scheduled(
    dictionary: Dictionary, arguments: Mapping[str, Any]
) -> tuple[CommandDefinition, dict[str, Value]] | None:
    """Decode the command in the standard arguments of a schedule, with its arguments; None if it cannot be decoded."""
    try:
        command = dictionary.command_of_code(int(arguments[COMMAND_CODE]))
        payload = arguments[PAYLOAD]
        data = bytes.fromhex(payload) if isinstance(payload, str) else bytes(payload)
        if command is None:
            return None
        return command, decode(command.arguments, data[: int(arguments[LENGTH])]).values
    except (GssError, KeyError, ValueError, TypeError):
        return None


def check_confirmation(risk: Risk, confirm: str) -> None:
    """Raise BadInput unless a critical command is confirmed by its typed name, or a warning one by "yes" or its name."""
    if risk.hazard is Hazard.CRITICAL and confirm != risk.name:
        raise BadInput(f"{risk.name} is critical and was not confirmed", expected=f"the name {risk.name} typed")
    if risk.hazard is Hazard.WARNING and confirm not in (YES, risk.name):
        raise BadInput(f"{risk.name} was not confirmed", expected="a confirmation: " + risk.reason)


def precondition_states(
    command: CommandDefinition, housekeeping: Mapping[str, Value] | None
) -> tuple[PreconditionState, ...]:
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


def check_unit(command: CommandDefinition, hello: HelloReceived | None) -> None:
    """Raise Conflict if a simulator-only command would go to a device that does not report itself as simulated."""
    if not command.simulator_only or (hello is not None and hello.simulated):
        return
    got = "no response from a device yet" if hello is None else f"{hello.serial or hello.device_model} is real"
    raise Conflict(f"{command.name} is for simulators only", expected="a simulated device", got=got)


def words(value: Any) -> str:
    """Return a telemetry value as display text."""
    if value is None:
        return "not received"
    return {True: "yes", False: "no"}[value] if isinstance(value, bool) else str(value).replace("_", " ")

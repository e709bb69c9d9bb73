"""Checks before a command is sent: preconditions, hazards, confirmation, simulator-only commands."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from gss.device.driver import Driver
from gss.device.protocol.codec import decode
from gss.device.session_events import HelloReceived
from gss.domain.errors import BadInput, Conflict, GssError
from gss.instruments.dictionary.definitions import CommandDefinition, Dictionary, Hazard, Value
from gss.instruments.operations import COMMAND_CODE, LENGTH, PAYLOAD, Operation, StandardOperations

YES = "yes"
REMEMBERED_IDS = 64
"""Number of request ids whose results a device stores, counted from the latest id. The device would execute a command
with an older id again."""


@dataclass(frozen=True)
class PreconditionState:
    """Current state of a precondition. ``met``: None if unknown. ``value``: text of the telemetry value that the
    precondition tests."""

    text: str
    met: bool | None
    value: str


@dataclass(frozen=True)
class Risk:
    """Hazard of a command with its arguments. ``name``: name to type as confirmation."""

    hazard: Hazard
    reason: str
    name: str

    @property
    def needs_confirmation(self) -> bool:
        """True if the operator must confirm the command or type its name."""
        return self.hazard in (Hazard.WARNING, Hazard.CRITICAL)


@dataclass(frozen=True)
class DryRun:
    """Result of a dry run. ``problems``: reasons why the command cannot be sent, except a missing confirmation.
    ``groups``: labelled parts (label, bytes) of the packet before framing; empty if the arguments are not valid.
    ``holder``: holder of command authority."""

    problems: tuple[str, ...]
    preconditions: tuple[PreconditionState, ...]
    groups: tuple[tuple[str, bytes], ...]
    risk: Risk
    role: str
    idempotent: bool
    holder: str | None


def risk_of(operations: StandardOperations, command: CommandDefinition, arguments: Mapping[str, Any]) -> Risk:
    """Return the highest hazard of a command with its argument values. For SCHEDULE, the hazard of the scheduled command is
    included."""
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
    """Return the subsystems of a command. For SCHEDULE, the subsystems of the scheduled command are included. If that command
    cannot be decoded, all subsystems are returned, so raw bytes cannot bypass permissions."""
    if operations.of_command(command.name, arguments) is not Operation.SCHEDULE:
        return frozenset({command.subsystem})
    inner = _carried(operations, command, arguments)
    carried = (
        subsystems_of(operations, *inner) if inner else frozenset(c.subsystem for c in operations.dictionary.commands)
    )
    return carried | {command.subsystem}


def _carried(
    operations: StandardOperations, command: CommandDefinition, arguments: Mapping[str, Any]
) -> tuple[CommandDefinition, dict[str, Value]] | None:
    """Return the command that SCHEDULE stores on board, with its arguments. Return None if ``command`` is not SCHEDULE
    or if the scheduled command cannot be decoded."""
    if operations.of_command(command.name, arguments) is not Operation.SCHEDULE:
        return None
    return scheduled(operations.dictionary, operations.given(Operation.SCHEDULE, arguments))


def scheduled(
    dictionary: Dictionary, arguments: Mapping[str, Any]
) -> tuple[CommandDefinition, dict[str, Value]] | None:
    """Decode the scheduled command and its arguments from the standard arguments of SCHEDULE. Return None if they cannot be
    decoded."""
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
    """Raise BadInput if a hazardous command is not confirmed. For the hazard critical, the user must type the name of
    the command. For the hazard warning, "yes" or the name is sufficient."""
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
        states.append(
            PreconditionState(condition.text, condition.met(housekeeping), _value_text(condition.field, value))
        )
    return tuple(states)


def _value_text(field: str, value: Value | None) -> str:
    """Return a value as text. A flag is described by its name: "running" or "not running" for ``cycle_running``."""
    if isinstance(value, bool):
        return ("" if value else "not ") + field.rsplit("_", 1)[-1]
    return words(value)


def check_unit(command: CommandDefinition, hello: HelloReceived | None) -> None:
    """Raise Conflict if a command is for simulators only and the connected device does not report that it is simulated."""
    if not command.simulator_only or (hello is not None and hello.simulated):
        return
    got = "no response from a device yet"
    if hello is not None:
        state = "is real" if hello.simulated is False else "does not report whether it is simulated"
        got = f"{hello.serial or hello.device_model} {state}"
    raise Conflict(f"{command.name} is for simulators only", expected="a simulated device", got=got)


def check_stored_result(session: Driver, request_id: int) -> None:
    """Raise Conflict if the device has no stored result for a request id, so that a retry could execute the command a second
    time."""
    if not session.stores_results or not 0 < session.next_request_id - request_id <= REMEMBERED_IDS:
        raise Conflict(
            "the device does not store the result of this id and can execute the command twice",
            expected=f"an idempotent command, or one of the last {REMEMBERED_IDS} ids of a device that stores results",
            got=f"{request_id}, the next is {session.next_request_id}",
            hint="check telemetry, mark the command resolved, and send a new one if it was not executed",
        )


def words(value: Any) -> str:
    """Return a telemetry value as text for display."""
    if value is None:
        return "not received"
    return {True: "yes", False: "no"}[value] if isinstance(value, bool) else str(value).replace("_", " ")

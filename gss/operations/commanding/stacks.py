"""Stacks: prepared lists of commands. All steps are checked before a stack is saved and before it runs.

A step is stored as a plain mapping: command, arguments, delay_s, condition (None or packet, field, op, value, wait_s), note. The
delay of a step is executed first, then the condition, then the command.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, TypedDict

from gss.device.protocol.codec import check_arguments
from gss.domain.errors import BadInput, Conflict, GssError
from gss.domain.json_object import JsonObject
from gss.instruments.dictionary.definitions import Precondition, TelemetryField
from gss.instruments.operations import Operation
from gss.instruments.roles import Roles
from gss.operations.clock import Now
from gss.operations.commanding.command_checks import PreconditionState, Risk, check_unit, risk_of
from gss.operations.commanding.commanding import CommandService
from gss.operations.line.link import LinkService
from gss.store import stacks as store
from gss.store.engine import Database
from gss.store.models import Stack

Step = Mapping[str, Any]
STEP = ("command", "arguments", "delay_s", "condition", "note")
FORMAT, VERSION = "gss-stack", 1
MAX_STEPS = 200
MAX_WAIT_S = 86_400.0
OPERATORS = ("eq", "ne", "lt", "le", "gt", "ge")


@dataclass(frozen=True)
class StepCheck:
    """Result of the dry run of one step. ``within_s``: longest duration, including delay, condition and report timeouts."""

    command: str
    arguments: Mapping[str, Any]
    risk: Risk
    role: str
    preconditions: Sequence[PreconditionState]
    problems: Sequence[str]
    groups: Sequence[tuple[str, bytes]]
    delay_s: float
    wait_s: float
    within_s: float


@dataclass(frozen=True)
class StackCheck:
    """Result of the dry run of a stack. ``confirm``: names to type, without duplicates. ``problems``: all reasons why the stack
    cannot run."""

    steps: Sequence[StepCheck]
    problems: Sequence[str]
    confirm: Sequence[str]

    @property
    def shortest_s(self) -> float:
        """Duration in seconds if all reports arrive and all conditions are met immediately."""
        return sum(step.delay_s for step in self.steps)

    @property
    def longest_s(self) -> float:
        """Duration in seconds if all conditions and reports take the permitted time."""
        return sum(step.within_s for step in self.steps)


class StackService:
    """Stores stacks and checks them in dry runs."""

    def __init__(self, link: LinkService, commands: CommandService, database: Database, now: Now) -> None:
        self._link, self._commands, self._database, self._now = link, commands, database, now

    # --- storage ------------------------------------------------------------------------------------------------

    def every(self) -> list[Stack]:
        """Return all stacks, sorted by name."""
        with self._database.unit_of_work() as session:
            return store.every(session)

    def get(self, stack_id: int) -> Stack:
        """Return the stack with that id. Raises NotFound."""
        with self._database.unit_of_work() as session:
            return store.get(session, stack_id)

    def create(self, name: str, note: str, steps: Sequence[Step], *, user: str) -> Stack:
        """Create a stack. Raises BadInput that names the invalid step, Conflict if the name is already used."""
        checked = checked_steps(self._link.roles, steps)
        with self._database.unit_of_work() as session:
            self._check_name(store.named(session, _name(name)), None)
            row = Stack(name=_name(name), note=note, steps=checked, author=user, changed=self._now())
            store.add(session, row)
        return row

    def change(self, stack_id: int, name: str, note: str, steps: Sequence[Step], *, user: str) -> Stack:
        """Replace the content of a stack. Raises NotFound, and BadInput and Conflict as :meth:`create` does."""
        checked = checked_steps(self._link.roles, steps)
        with self._database.unit_of_work() as session:
            row = store.get(session, stack_id)
            self._check_name(store.named(session, _name(name)), row)
            row.name, row.note, row.steps = _name(name), note, checked
            row.author, row.changed = user, self._now()
        return row

    def delete(self, stack_id: int) -> None:
        """Delete a stack. The records of its runs remain stored."""
        with self._database.unit_of_work() as session:
            store.delete(session, stack_id)

    @staticmethod
    def _check_name(same_name: Stack | None, replaced: Stack | None) -> None:
        if same_name is not None and (replaced is None or same_name.id != replaced.id):
            raise Conflict(
                "a stack with this name exists", got=same_name.name, hint="choose another name, or edit that stack"
            )

    # --- files --------------------------------------------------------------------------------------------------

    def exported(self, stack_id: int) -> JsonObject:
        """Return a stack in the file format, for import into another installation."""
        row = self.get(stack_id)
        head = {"format": FORMAT, "version": VERSION, "dictionary": self._link.dictionary.hash_hex}
        return head | {"name": row.name, "note": row.note, "steps": row.steps}

    # --- dry run ------------------------------------------------------------------------------------------------

    def check(self, steps: Sequence[Step], *, user: str) -> StackCheck:
        """Dry run of a stack: return bytes, hazards, conditions and durations of all steps. Nothing is sent."""
        if not 1 <= len(steps) <= MAX_STEPS:
            raise BadInput("invalid number of steps", expected=f"1 – {MAX_STEPS}", got=str(len(steps)))
        checks = [self._check_step(step, user) for step in steps]
        problems = [f"step {k + 1}: {text}" for k, step in enumerate(checks) for text in step.problems]
        if not self._link.connected:
            problems.append(f"the line is down: {self._link.reason}")
        try:
            self._commands.check_user(user)
        except GssError as error:
            problems.append(str(error))
        names = dict.fromkeys(step.risk.name for step in checks if step.risk.needs_confirmation)
        return StackCheck(checks, problems, list(names))

    def confirmation(self, step: Step) -> str:
        """Return the text that confirms a step, "" if it needs no confirmation."""
        operations = self._link.roles.operations
        risk = risk_of(operations, operations.dictionary.command(str(step["command"])), step["arguments"])
        return risk.name if risk.needs_confirmation else ""

    def check_permitted(self, steps: Sequence[Step], *, user: str) -> None:
        """Raise NotPermitted if the user does not have the permission for one of the steps."""
        for step in steps:
            self._commands.check_permitted(user, str(step["command"]), step.get("arguments") or {})

    def _check_step(self, step: Step, user: str) -> StepCheck:
        operations = self._link.roles.operations
        command, arguments = operations.dictionary.command(str(step["command"])), step.get("arguments") or {}
        problems: list[str] = []
        groups: list[tuple[str, bytes]] = []
        try:
            checked_step(self._link.roles, step)
            self._commands.check_permitted(user, command.name, arguments)
            check_unit(command, self._link.hello)
            groups = self._commands.preview(self._link.session.encode(command.name, arguments))
        except GssError as error:
            problems.append(str(error))
        condition = step.get("condition")
        delay_s, wait_s = float(step.get("delay_s") or 0.0), float(condition["wait_s"]) if condition else 0.0
        return StepCheck(
            command=command.name,
            arguments=arguments,
            risk=risk_of(operations, command, arguments),
            role=command.role,
            preconditions=self._commands.preconditions(command),
            problems=problems,
            groups=groups,
            delay_s=delay_s,
            wait_s=wait_s,
            within_s=delay_s + wait_s + command.accept_s + command.complete_s,
        )


class CheckedCondition(TypedDict):
    """A condition of a step. The step waits up to ``wait_s`` until the comparison of the field with ``value`` is true."""

    packet: str
    field: str
    op: str
    value: Any
    wait_s: float


class CheckedStep(TypedDict):
    """A complete step in the form in which it is stored and exported."""

    command: str
    arguments: Mapping[str, Any]
    delay_s: float
    condition: CheckedCondition | None
    note: str


def checked_steps(roles: Roles, steps: Sequence[Step]) -> list[CheckedStep]:
    """Return the complete steps, including default arguments. Raises BadInput that names the first invalid step."""
    if not 1 <= len(steps) <= MAX_STEPS:
        raise BadInput("invalid number of steps", expected=f"1 – {MAX_STEPS}", got=str(len(steps)))
    checked = []
    for number, step in enumerate(steps, 1):
        try:
            checked.append(checked_step(roles, step))
        except GssError as error:
            raise BadInput(f"step {number}: {error.message}", expected=error.expected, got=error.got) from error
    return checked


def checked_step(roles: Roles, step: Step) -> CheckedStep:
    """Return one complete step, including default arguments. Raises BadInput if it is not valid."""
    if not isinstance(step, Mapping) or set(step) - {*STEP}:
        raise BadInput("not a step", expected=", ".join(STEP), got=str(step)[:120])
    command = roles.operations.dictionary.command(str(step.get("command")))
    if roles.operations.of_command(command.name) is Operation.ABORT:
        raise BadInput("ABORT cannot be a step of a stack", expected="another command")
    arguments = step.get("arguments") or {}
    if not isinstance(arguments, Mapping):
        raise BadInput("arguments are not a mapping", expected="name: value", got=str(arguments)[:80])
    values = check_arguments(command, arguments)
    condition, note = step.get("condition"), step.get("note") or ""
    return {
        "command": command.name,
        "arguments": {k: v.hex() if isinstance(v, bytes) else v for k, v in values.items()},
        "delay_s": _seconds("delay_s", step.get("delay_s") or 0.0, 0.0),
        "condition": None if condition is None else _condition(roles, condition),
        "note": str(note)[:500],
    }


def _condition(roles: Roles, condition: Mapping[str, Any]) -> CheckedCondition:
    if not isinstance(condition, Mapping) or set(condition) - {"packet", "field", "op", "value", "wait_s"}:
        raise BadInput("not a condition", expected="packet, field, op, value, wait_s", got=str(condition)[:120])
    packet = roles.operations.dictionary.packet(str(condition.get("packet") or roles.quantities.status.packet))
    field = next((f for f in packet.values if f.name == condition.get("field")), None)
    if field is None:
        raise BadInput(f"{packet.name} has no such field", got=str(condition.get("field")))
    op, value = str(condition.get("op")), condition.get("value")
    if op not in OPERATORS:
        raise BadInput("unknown comparison", expected=" ".join(OPERATORS), got=op)
    _check_value(field, op, value)
    wait_s = _seconds("wait_s", condition.get("wait_s", 10.0), 1.0)
    return {"packet": packet.name, "field": field.name, "op": op, "value": value, "wait_s": wait_s}


def _check_value(field: TelemetryField, op: str, value: Any) -> None:
    """Raise BadInput for a comparison that the field's type does not support."""
    if field.type == "enum":
        field.choice(str(value))
        is_supported = op in ("eq", "ne")
    elif field.type == "bool":
        is_supported = isinstance(value, bool) and op in ("eq", "ne")
    elif field.type in ("str", "text", "bytes"):
        is_supported = isinstance(value, str) and op in ("eq", "ne")
    else:
        is_supported = isinstance(value, int | float) and not isinstance(value, bool)
    if not is_supported:
        raise BadInput(f"{field.name} is {field.type} and does not support this comparison", got=f"{op} {value!r}"[:80])


def _seconds(name: str, value: Any, min_s: float) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not min_s <= value <= MAX_WAIT_S:
        raise BadInput(f"{name} is out of range", expected=f"{min_s:g} – {MAX_WAIT_S:g} s", got=str(value)[:40])
    return float(value)


def _name(name: str) -> str:
    checked = " ".join(name.split())
    if not 0 < len(checked) <= 80:
        raise BadInput("the name of the stack is not valid", expected="1 – 80 characters", got=str(len(checked)))
    return checked


def condition_of(condition: Mapping[str, Any]) -> Precondition:
    """Return the condition of a step as a dictionary precondition."""
    text = f"{condition['field']} {condition['op']} {condition['value']}"
    return Precondition(condition["field"], condition["op"], condition["value"], text)

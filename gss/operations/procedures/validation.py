"""Validation of a procedure against the dictionary."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from gss.domain.errors import BadInput, GssError
from gss.domain.expressions import parse
from gss.instruments.dictionary.checked_values import check_arguments
from gss.instruments.dictionary.definitions import FLOATS, INTEGER_RANGES, CommandDefinition, Value
from gss.instruments.operations import Operation, StandardOperations
from gss.operations.commanding.command_checks import risk_of
from gss.operations.procedures.document import END, NEXT, Mistake, ProcedureDocument, ProcedureStep, command_words
from gss.operations.telemetry.derived import kinds_of
from gss.operations.telemetry.field_definitions import TelemetryDefinitions


def mistakes_of(
    document: ProcedureDocument, operations: StandardOperations, definitions: TelemetryDefinitions
) -> list[Mistake]:
    """Return all mistakes in order of lines: unreadable parts, unknown commands and fields, arguments out of range, unknown
    targets, duplicate names, and steps that cannot be reached."""
    mistakes = [*document.mistakes]
    kinds = kinds_of(definitions)
    for step in document.steps:
        try:
            if step.kind == "command" and step.words:
                command_of(step, operations)
            for text in expressions_of(step):
                if parse(text).kind(kinds) != "bool":
                    raise BadInput("The expression is not a condition", expected="a comparison or yes/no", got=text)
        except GssError as error:
            mistakes.append(Mistake(step.at, str(error)))
    return sorted([*mistakes, *_graph(document)], key=lambda mistake: mistake.line)


def expressions_of(step: ProcedureStep) -> Sequence[str]:
    """Return the condition expressions of a step."""
    if step.kind == "check":
        return [step.words] if step.words else []
    if step.kind == "branch":
        return [branch.when.removeprefix("if ") for branch in step.branches if branch.when != "else"]
    return []


def command_of(step: ProcedureStep, operations: StandardOperations) -> tuple[CommandDefinition, Mapping[str, Value]]:
    """Return the command of a step with all its arguments. Raises BadInput, NotFound."""
    name, arguments = command_words(step.words)
    command = operations.dictionary.command(name)
    values = check_arguments(command, {key: _typed(command, key, text) for key, text in arguments.items()})
    if operations.of_command(name, values) is Operation.ABORT:
        raise BadInput("ABORT cannot be a step of a procedure", expected="another command")
    return command, values


def confirmation_of(step: ProcedureStep, operations: StandardOperations) -> str:
    """Return the name that confirms a step's command, "" if it needs no confirmation. Raises BadInput, NotFound."""
    command, arguments = command_of(step, operations)
    risk = risk_of(operations, command, arguments)
    return risk.name if risk.needs_confirmation else ""


def _typed(command: CommandDefinition, name: str, text: str) -> Value:
    """Convert the text of an argument to a value of its type. Raises BadInput, NotFound."""
    argument = command.argument(name)
    try:
        if argument.type in INTEGER_RANGES:
            return int(text, 0)
        if argument.type in FLOATS:
            return float(text)
    except ValueError:
        raise BadInput(f"The argument {name} is not a number", expected=argument.range_text, got=text[:40]) from None
    if argument.type == "bool":
        if text not in ("true", "false"):
            raise BadInput(f"The argument {name} is not yes/no", expected="true | false", got=text[:40])
        return text == "true"
    return text


def _graph(document: ProcedureDocument) -> list[Mistake]:
    ids = [step.id for step in document.steps]
    mistakes = [
        Mistake(step.line, f"The step name {step.id} is used twice.")
        for k, step in enumerate(document.steps)
        if step.id in ids[:k]
    ]
    mistakes += [
        Mistake(step.at, f"There is no step {branch.target}. Write the name of a step, next or end.")
        for step in document.steps
        for branch in step.branches
        if branch.target not in (NEXT, END, *ids)
    ]
    reached = _reached(document)
    return mistakes + [
        Mistake(step.line, f"The step {step.id} cannot be reached from the first step.")
        for step in document.steps
        if step.id not in reached
    ]


def _reached(document: ProcedureDocument) -> set[str]:
    reached: set[str] = set()
    pending = [document.steps[0].id] if document.steps else []
    steps = {step.id: step for step in document.steps}
    while pending:
        step = steps.get(pending.pop())
        if step is None or step.id in reached:
            continue
        reached.add(step.id)
        pending += [following for target in step.targets() if (following := document.after(step, target)) is not None]
    return reached

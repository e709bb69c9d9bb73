"""Conversion of a stack to the text of a procedure, with waits, checks and commands as steps."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from gss.domain.errors import BadInput
from gss.operations.commanding.stacks import Step

SIGNS = {"eq": "==", "ne": "!=", "lt": "<", "le": "<=", "gt": ">", "ge": ">="}


def procedure_of_stack(name: str, note: str, steps: Sequence[Step]) -> str:
    """Return a stack as the text of a procedure. Each step becomes a wait and a check, if it has them, and a command.

    Raises BadInput for an argument with a line break or a control character.
    """
    parts = [f"# {' '.join(name.split())}\n"]
    if note:
        parts.append(_quoted(note))
    for number, step in enumerate(steps, 1):
        parts += _parts(number, step)
    return "\n".join(parts)


def _parts(number: int, step: Step) -> Iterator[str]:
    command = step["command"]
    if step["delay_s"]:
        yield _section(f"wait-{number}", f"Wait before {command}", "wait", _seconds(step["delay_s"]))
    if step["condition"]:
        condition = step["condition"]
        expression = (
            f"{condition['packet']}.{condition['field']} {SIGNS[condition['op']]} {json.dumps(condition['value'])}"
        )
        within = f"within: {_seconds(condition['wait_s'])}"
        yield _section(f"check-{number}", f"Check before {command}", "check", expression, within)
    command_line = shlex.join([command, *(f"{key}={_value_text(value)}" for key, value in _arguments(step).items())])
    if not command_line.isprintable():
        raise BadInput(
            f"Step {number} cannot be written as a procedure", expected="printable arguments", got=repr(command_line)
        )
    yield _section(f"send-{number}", f"Send {command}", "command", command_line, note=step["note"])


def _seconds(value: float) -> str:
    """Return a duration in the format of procedures, without an exponent."""
    return f"{value:.6f}".rstrip("0").rstrip(".") + " s"


def _arguments(step: Step) -> Mapping[str, Any]:
    arguments: Mapping[str, Any] = step["arguments"]
    return arguments


def _section(name: str, title: str, kind: str, *lines: str, note: str = "") -> str:
    prose = f"\n{_quoted(note)}" if note else ""
    return f"## {name}: {title}\n{prose}\n" + "\n".join([f"```{kind}", *lines, "```", ""])


def _quoted(text: str) -> str:
    """Return text as a Markdown quotation, in which lines are never headings or actions."""
    return "\n".join(f"> {line}" for line in text.splitlines()) + "\n"


def _value_text(value: object) -> str:
    return json.dumps(value) if isinstance(value, bool) else str(value)

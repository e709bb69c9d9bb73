"""Stacks as procedures: a stack is a procedure whose steps are waits, checks and commands."""

from __future__ import annotations

import json
import shlex
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from gss.domain.errors import BadInput
from gss.operations.commanding.stacks import Step

SIGNS = {"eq": "==", "ne": "!=", "lt": "<", "le": "<=", "gt": ">", "ge": ">="}


def procedure_of_stack(name: str, note: str, steps: Sequence[Step]) -> str:
    """Return a stack as the text of a procedure: for each step a wait and a check, where it has them, and its command.

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
    words = shlex.join([command, *(f"{key}={_word(value)}" for key, value in _arguments(step).items())])
    if not words.isprintable():
        raise BadInput(
            f"Step {number} cannot be written as a procedure", expected="printable arguments", got=repr(words)
        )
    yield _section(f"send-{number}", f"Send {command}", "command", words, note=step["note"])


def _seconds(value: float) -> str:
    """Return a time as the reader of procedures accepts it, without an exponent."""
    return f"{value:.6f}".rstrip("0").rstrip(".") + " s"


def _arguments(step: Step) -> Mapping[str, Any]:
    arguments: Mapping[str, Any] = step["arguments"]
    return arguments


def _section(name: str, title: str, kind: str, *lines: str, note: str = "") -> str:
    prose = f"\n{_quoted(note)}" if note else ""
    return f"## {name}: {title}\n{prose}\n" + "\n".join([f"```{kind}", *lines, "```", ""])


def _quoted(text: str) -> str:
    """Return text as a quotation, in which nothing is a heading or an action."""
    return "\n".join(f"> {line}" for line in text.splitlines()) + "\n"


def _word(value: object) -> str:
    return json.dumps(value) if isinstance(value, bool) else str(value)

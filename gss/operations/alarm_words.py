"""What an alarm says."""

from __future__ import annotations

from gss.device.dictionary import TelemetryField
from gss.domain.limits import State
from gss.operations.limit_book import Rule
from gss.operations.value_words import formatted

LONGEST = 120


def with_unit(value: float, field: TelemetryField) -> str:
    """A value as the pages show it."""
    if field.type == "bool":
        return formatted(bool(value), 0)
    shown = formatted(value if field.decimals or not value.is_integer() else int(value), field.decimals)
    return f"{shown} {field.unit}".rstrip()


def limit_text(rule: Rule, state: State, value: float) -> str:
    """The limit that was left: "above 55 (warning)"."""
    for level, (low, high) in rule.limits.levels:
        if level is state:
            if low is not None and value < low:
                return f"below {low:g} ({level})"
            if high is not None and value > high:
                return f"above {high:g} ({level})"
    return f"outside ({state})"


def cut(text: str) -> str:
    """At most as long as the row can keep."""
    return text if len(text) <= LONGEST else text[: LONGEST - 1] + "…"

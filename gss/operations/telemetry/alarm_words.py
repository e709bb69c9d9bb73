"""Texts of alarms."""

from __future__ import annotations

from dataclasses import dataclass

from gss.device.dictionary import Dictionary, TelemetryField
from gss.domain.limits import State
from gss.operations.telemetry.limit_book import Rule
from gss.operations.telemetry.telemetry_board import Key
from gss.operations.telemetry.value_words import formatted
from gss.store.models import Alarm

LONGEST = 120
EVENT, LINK, CATALOGUE, STORE = "event", "link", "catalogue", "store"
UNMEASURED = (EVENT, LINK, CATALOGUE, STORE)
"""Pseudo packet names of alarms that are not about a telemetry field."""
SIGNAL: Key = (LINK, "housekeeping")


@dataclass(frozen=True)
class AlarmView:
    """An alarm's row with its current level and display texts."""

    row: Alarm
    level: State
    title: str
    unit: str
    text: str
    shelved: bool


def field_of(dictionary: Dictionary, row: Alarm) -> TelemetryField | None:
    """Return the field that an alarm is about; None for events, the line, and fields that the current dictionary lacks."""
    packets = [p for p in dictionary.telemetry if p.name == row.packet]
    return next((f for p in packets for f in p.values if f.name == row.field), None)


def title_of(dictionary: Dictionary, row: Alarm) -> str:
    """Return the title of an alarm."""
    if (row.packet, row.field) == SIGNAL:
        return "Loss of signal"
    if row.packet == CATALOGUE:
        return f"Catalogue {row.field}"
    if row.packet == STORE:
        return row.field.capitalize()
    field = field_of(dictionary, row)
    return field.title if field else row.field


def text_of(dictionary: Dictionary, row: Alarm) -> str:
    """Return the text of an alarm for the header bar."""
    if row.packet == EVENT:
        times = int(row.value or 1)
        return f"{row.limit_text} ({times} times)" if times > 1 else row.limit_text
    before = {"cleared": "Was: ", "acked": "Seen: "}.get(row.state, "")
    return f"{before}{title_of(dictionary, row)} {row.limit_text}"


def with_unit(value: float, field: TelemetryField) -> str:
    """Return a value with its unit, as displayed."""
    if field.type == "bool":
        return formatted(bool(value), 0)
    shown = formatted(value if field.decimals or not value.is_integer() else int(value), field.decimals)
    return f"{shown} {field.unit}".rstrip()


def limit_text(rule: Rule, state: State, value: float) -> str:
    """Return the limit that was exceeded: "above 55 (warning)"."""
    for level, (low, high) in rule.limits.levels:
        if level is state:
            if low is not None and value < low:
                return f"below {low:g} ({level})"
            if high is not None and value > high:
                return f"above {high:g} ({level})"
    return f"outside ({state})"


def cut(text: str) -> str:
    """Truncate a text to the length of its column."""
    return text if len(text) <= LONGEST else text[: LONGEST - 1] + "…"

"""Texts of alarms."""

from __future__ import annotations

from dataclasses import dataclass

from gss.domain.limits import State
from gss.instruments.dictionary.definitions import TelemetryField
from gss.operations.telemetry.field_definitions import TelemetryDefinitions
from gss.operations.telemetry.limit_book import Rule
from gss.operations.telemetry.limit_check import Key
from gss.operations.telemetry.value_format import formatted
from gss.store.models import Alarm

MAX_LENGTH = 120
"""Length of the column ``limit_text``."""
EVENT, LINK, CATALOGUE, STORE, MARGIN, HEADS = "event", "link", "catalogue", "store", "margin", "heads"
UNMEASURED = (EVENT, LINK, CATALOGUE, STORE, MARGIN, HEADS)
"""Pseudo packet names of alarms without a telemetry field."""
SIGNAL: Key = (LINK, "housekeeping")
NO_STATUS: Key = (LINK, "status")
"""Alarm of a sensor that answers without sending housekeeping."""
LINK_TITLES = {SIGNAL: "Loss of signal", NO_STATUS: "No housekeeping"}


@dataclass(frozen=True)
class AlarmView:
    """An alarm's row with its current level and display texts. ``action``: what the operator should do, "" if not
    stated."""

    row: Alarm
    level: State
    title: str
    unit: str
    text: str
    shelved: bool
    action: str


def field_of(dictionary: TelemetryDefinitions, row: Alarm) -> TelemetryField | None:
    """Return the telemetry field of an alarm; None for events, the line, and fields that are not in the dictionary."""
    packets = [p for p in dictionary.telemetry if p.name == row.packet]
    return next((f for p in packets for f in p.values if f.name == row.field), None)


def title_of(dictionary: TelemetryDefinitions, row: Alarm) -> str:
    """Return the title of an alarm."""
    if row.packet == LINK:
        return LINK_TITLES.get((row.packet, row.field), row.field)  # another version can have stored other alarms
    if row.packet == CATALOGUE:
        return f"Catalogue {row.field}"
    if row.packet == STORE:
        return row.field.capitalize()
    if row.packet == MARGIN:
        return f"Angle to {row.field}"
    field = field_of(dictionary, row)
    return field.title if field else row.field


def unit_of(dictionary: TelemetryDefinitions, row: Alarm) -> str:
    """Return the unit of an alarm's value; "" if it has none."""
    field = field_of(dictionary, row)
    return field.unit if field else "deg" if row.packet == MARGIN else ""


ACTIONS = {
    LINK: "Check cable, power and pointing of the antenna. Open the line again on the page Contacts if the port was lost.",
    CATALOGUE: "Upload a catalogue that is valid for longer, then activate and confirm it.",
    HEADS: "Open the page Fleet, which shows which heads differ and by how much. If the estimate is steady, correct the mounting; "
    "until then, use the attitude of the other heads.",
    STORE: "Open the page Admin. Health and Storage state the cause and the remedy.",
    MARGIN: "Turn the spacecraft away, or expect few or no attitudes until the angle grows. Do not leave the Sun in the field.",
}
"""Operator actions for alarms that no dictionary describes."""


BOOT_ACTION = "Boot the sensor if it starts in a bootloader: see the notes of its instrument. Otherwise check its mode."


def action_of(dictionary: TelemetryDefinitions, row: Alarm) -> str:
    """Return the operator action for an alarm: from the instrument's dictionary, or from ACTIONS for an alarm of the
    server."""
    if row.packet == EVENT:
        return next((e.action for e in dictionary.events if e.name == row.field), "")
    if (row.packet, row.field) == NO_STATUS:
        return BOOT_ACTION
    field = field_of(dictionary, row)
    return field.action if field else ACTIONS.get(row.packet, "")


def text_of(dictionary: TelemetryDefinitions, row: Alarm) -> str:
    """Return the text of an alarm for the header bar."""
    if row.packet == EVENT:
        times = int(row.value or 1)
        return f"{row.limit_text} ({times} times)" if times > 1 else row.limit_text
    prefix = {"cleared": "Cleared, not acknowledged: ", "acked": "Acknowledged: "}.get(row.state, "")
    if row.packet == HEADS:  # the text names the head and the quantity, the field also the spacecraft
        return f"{prefix}{row.field.rpartition(': ')[0]}: {row.limit_text}"
    return f"{prefix}{title_of(dictionary, row)} {row.limit_text}"


def with_unit(value: float, field: TelemetryField) -> str:
    """Return a value with its unit, as displayed."""
    if field.type == "bool":
        return formatted(bool(value), 0)
    value_text = formatted(value if field.decimals or not value.is_integer() else int(value), field.decimals)
    return f"{value_text} {field.unit}".rstrip()


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
    """Truncate a text to MAX_LENGTH characters."""
    return text if len(text) <= MAX_LENGTH else text[: MAX_LENGTH - 1] + "…"

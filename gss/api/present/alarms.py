"""Alarms as responses."""

from __future__ import annotations

from gss.api.schemas.alarms import AlarmRow
from gss.operations.telemetry.alarm_text import AlarmView

NAMES = (
    "id packet field state worst value limit_text limit_set raised cleared acknowledged acknowledged_by shelved_until shelved_by "
    "note closed"
)


def alarm(view: AlarmView) -> AlarmRow:
    """Return an alarm as a response."""
    return AlarmRow(
        **{name: getattr(view.row, name) for name in NAMES.split()},
        title=view.title,
        level=view.level.value,
        unit=view.unit,
        text=view.text,
        shelved=view.shelved,
        action=view.action,
    )

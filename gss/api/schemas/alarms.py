"""Latching alarms."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from gss.api.schemas.base import In, Out, Utc
from gss.api.schemas.telemetry import LevelName


class AlarmRow(Out):
    """Alarm. ``state``: raised (out of limits, not acknowledged), acked (out of limits, acknowledged), cleared (within
    limits, not acknowledged), closed. ``level``: current level; ``worst``: worst level since the alarm was raised.
    Packet "event": event of the device, with the number of occurrences as the value. Packet "link": loss of signal.
    ``action``: operator action from the instrument package; "" if not stated."""

    id: int
    packet: str
    field: str
    title: str
    state: Literal["raised", "acked", "cleared", "closed"]
    level: LevelName
    worst: LevelName
    value: float | None
    unit: str
    text: str
    limit_text: str
    limit_set: str
    raised: Utc
    cleared: Utc | None
    acknowledged: Utc | None
    acknowledged_by: str
    shelved: bool
    shelved_until: Utc | None
    shelved_by: str
    note: str
    closed: Utc | None
    action: str


class NoteIn(In):
    """Note for the record."""

    note: str = Field(default="", max_length=1000)


class ShelveIn(In):
    """Duration and reason of shelving an alarm."""

    minutes: int = Field(ge=1, le=1440)
    note: str = Field(min_length=1, max_length=1000)

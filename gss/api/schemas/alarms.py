"""Latching alarms."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from gss.api.schemas.base import In, Out, Utc
from gss.api.schemas.telemetry import LevelWord


class AlarmRow(Out):
    """One alarm. raised: out and not seen; acked: out and seen; cleared: back in and not seen; closed: over.
    ``level``: of the moment; ``worst``: since it was raised. packet "event": an event of the device, with how often it came as
    its value; packet "link": loss of signal."""

    id: int
    packet: str
    field: str
    title: str
    state: Literal["raised", "acked", "cleared", "closed"]
    level: LevelWord
    worst: LevelWord
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


class NoteIn(In):
    """A word for the record."""

    note: str = Field(default="", max_length=1000)


class ShelveIn(In):
    """For how long an alarm is not to be shown, and why."""

    minutes: int = Field(ge=1, le=1440)
    note: str = Field(min_length=1, max_length=1000)

"""Time-tagged commands stored on the device."""

from __future__ import annotations

from datetime import datetime
from typing import Literal

from pydantic import Field

from gss.api.schemas.base import In, Out, Utc
from gss.api.schemas.commands import ByteGroupOut, HazardName
from gss.domain.json_object import JsonObject


class EntryOut(Out):
    """Row of the device's schedule. ``at``: null until the clocks are correlated; ``command``: null if the dictionary
    cannot decode the bytes; then only ``hex`` is meaningful."""

    schedule_id: int
    at_device_s: float
    at: Utc | None
    uncertainty_s: float | None
    command: str | None
    arguments: JsonObject
    text: str
    hazard: HazardName
    state: Literal["waiting", "done", "failed", "cancelled", "missed"]
    reason: str
    hex: str


class DeviceClockOut(Out):
    """Device clock at a UTC time, with its uncertainty and the number and span of the clock samples used."""

    device_s: float
    utc: Utc
    uncertainty_s: float
    drift_ppm: float | None
    samples: int
    span_s: float


class ScheduleOut(Out):
    """Schedule ordered by time. ``reported``: time of the device's last report; ``complete``: true if this report was
    received completely."""

    entries: list[EntryOut]
    reported: Utc | None
    complete: bool
    clock: DeviceClockOut | None


class ScheduleCheckIn(In):
    """Command to schedule, at a time in UTC or on the device's clock."""

    command: str
    arguments: dict[str, float | int | str | bool] = Field(default_factory=dict)
    at: datetime | None = Field(default=None, strict=False)
    at_device_s: float | None = None


class ScheduleIn(ScheduleCheckIn):
    """Command to schedule, with its confirmation."""

    confirm: str = ""


class ScheduleCheckOut(Out):
    """Dry run of SCHEDULE: its content, its problems and its warnings."""

    problems: list[str]
    warnings: list[str]
    at_device_s: float | None
    at: Utc | None
    uncertainty_s: float | None
    hazard: HazardName
    hazard_reason: str
    confirm_name: str
    role: str
    bytes: list[ByteGroupOut]
    size: int

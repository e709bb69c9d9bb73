"""Commands that the device keeps for later."""

from __future__ import annotations

from datetime import datetime
from typing import Any, Literal

from pydantic import Field

from gss.api.schemas.base import In, Out, Utc
from gss.api.schemas.commands import ByteGroupOut, HazardName


class EntryOut(Out):
    """One row of the device's table. ``at`` is None while the clocks are not correlated; ``command`` is None where the bytes
    are not of our dictionary, then ``hex`` is all there is."""

    schedule_id: int
    at_device_s: float
    at: Utc | None
    uncertainty_s: float | None
    command: str | None
    arguments: dict[str, Any]
    text: str
    hazard: HazardName
    state: Literal["waiting", "done", "failed", "cancelled", "missed"]
    reason: str
    hex: str


class ClockOut(Out):
    """The device's clock at a moment of UTC, how well that is known, and from how much."""

    device_s: float
    utc: Utc
    uncertainty_s: float
    drift_ppm: float | None
    samples: int
    span_s: float


class ScheduleOut(Out):
    """The table by time. ``told``: when the device last listed it; ``complete``: nothing of that list was lost."""

    entries: list[EntryOut]
    told: Utc | None
    complete: bool
    clock: ClockOut | None


class ScheduleCheckIn(In):
    """A command for later: its moment either in UTC or on the device's clock."""

    command: str
    arguments: dict[str, float | int | str | bool] = Field(default_factory=dict)
    at: datetime | None = Field(default=None, strict=False)
    at_device_s: float | None = None


class ScheduleIn(ScheduleCheckIn):
    """The same, confirmed."""

    confirm: str = ""


class ScheduleCheckOut(Out):
    """What SCHEDULE would carry, what is wrong with it, and what to think of."""

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

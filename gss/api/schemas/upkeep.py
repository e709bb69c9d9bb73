"""Health, retention, backups."""

from __future__ import annotations

from pydantic import AwareDatetime, Field

from gss.api.schemas.base import In, Out, Utc


class HealthCheckOut(Out):
    """One thing that was looked at. ``state``: ok, watch, warning, critical, unknown."""

    name: str
    state: str
    value: float | None
    text: str


class HealthOut(Out):
    """Everything that was looked at, and the worst state."""

    state: str
    checks: list[HealthCheckOut]


class RetentionIn(In):
    """0 keeps for ever."""

    frames_days: float = Field(
        default=0, ge=0, le=36_500, description="Pixels go at this age; rows and solutions stay."
    )
    frames_gb: float = Field(default=0, ge=0, le=1e6, description="The oldest pixels go while all are larger together.")
    keep_frames: int = Field(default=100, ge=0, le=10**6, description="The pixels of so many newest frames never go.")
    telemetry_thin_days: float = Field(
        default=0, ge=0, le=36_500, description="From this age one packet a minute stays."
    )
    telemetry_days: float = Field(default=0, ge=0, le=36_500, description="Packets go at this age.")
    events_days: float = Field(default=0, ge=0, le=36_500, description="Lines of the record go at this age.")
    captures_mb: int = Field(default=0, ge=0, le=10**8, description="Raw captures together; 0: GSS_CAPTURE_KEEP_MB.")
    backups_keep: int = Field(default=0, ge=0, le=10**4, description="So many newest backups stay.")


class ForecastOut(Out):
    """What is on the disk and how it grows. ``bytes_per_day`` null: too young to say; ``full_in_days`` null: that, or it does not
    grow."""

    database_bytes: int
    frames_bytes: int
    captures_bytes: int
    backups_bytes: int
    free_bytes: int
    bytes_now: int
    bytes_per_day: float | None
    full_in_days: float | None
    next_removal: Utc | None
    removable_bytes: int


class ClockOut(Out):
    """The server's clock and the last trusted time. ``doubt``: why nothing is deleted; empty where the clock is plausible."""

    now: Utc
    trusted: Utc | None
    doubt: str


class ConfirmClockIn(In):
    """``seen``: the server's time as it was shown to the person who checked it."""

    seen: AwareDatetime = Field(strict=False)


class RetentionOut(RetentionIn):
    """What is in force, and what follows. ``waiting``: what the last removal would have taken, where it waits for confirmation."""

    last_run: Utc | None
    waiting: str
    clock: ClockOut
    forecast: ForecastOut


class RemovalOut(Out):
    """What a removal would take as of ``at``. ``frames_bytes``: of their pixels; ``to_thin``: packets of which one a minute stays;
    ``unusual``: why a person must confirm it, empty where it may run."""

    at: Utc
    frames: int
    frames_bytes: int
    packets: int
    to_thin: int
    events: int
    unusual: str


class ConfirmedIn(In):
    """The preview that was confirmed: of the policy in force, as of ``at``."""

    at: AwareDatetime = Field(strict=False)
    frames: int = Field(ge=0)
    frames_bytes: int = Field(ge=0)
    packets: int = Field(ge=0)
    to_thin: int = Field(ge=0)
    events: int = Field(ge=0)


class RunRetentionIn(In):
    """``confirmed``: needed where the preview says that the removal is unusual."""

    confirmed: ConfirmedIn | None = None


class BackupOut(Out):
    """A backup. ``bytes``: of everything that it names; what backups share lies on the disk once."""

    name: str
    created: Utc
    version: str
    schema_version: str
    kind: str
    bytes: int
    blobs: int
    captures: int


class FavouriteIn(In):
    """Should retention leave this frame alone?"""

    favourite: bool

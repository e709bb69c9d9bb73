"""Health, retention and backups."""

from __future__ import annotations

from pydantic import AwareDatetime, Field

from gss.api.schemas.base import In, Out, Utc


class HealthCheckOut(Out):
    """Result of one health check. ``state``: ok, watch, warning, critical or unknown."""

    name: str
    state: str
    value: float | None
    text: str


class HealthOut(Out):
    """All health checks and the worst state."""

    state: str
    checks: list[HealthCheckOut]


class RetentionIn(In):
    """Retention policy; 0 keeps data for ever."""

    frames_days: float = Field(
        default=0, ge=0, le=36_500, description="Age at which pixels are deleted; metadata and solutions are kept."
    )
    frames_gb: float = Field(
        default=0, ge=0, le=1e6, description="Total size above which the oldest pixels are deleted."
    )
    keep_frames: int = Field(
        default=100, ge=0, le=10**6, description="Number of newest frames whose pixels are always kept."
    )
    telemetry_thin_days: float = Field(
        default=0, ge=0, le=36_500, description="Age at which packets are thinned to one per minute."
    )
    telemetry_days: float = Field(default=0, ge=0, le=36_500, description="Age at which packets are deleted.")
    events_days: float = Field(default=0, ge=0, le=36_500, description="Lines of the record go at this age.")
    captures_mb: int = Field(
        default=0, ge=0, le=10**8, description="Total size of the raw captures; 0: GSS_CAPTURE_KEEP_MB."
    )
    backups_keep: int = Field(default=0, ge=0, le=10**4, description="Number of newest backups to keep.")


class ForecastOut(Out):
    """Disk usage and its growth. ``bytes_per_day`` null: not enough data yet; ``full_in_days`` null: not enough data,
    or no growth."""

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


class ServerClockOut(Out):
    """Server clock and the last trusted time. ``doubt``: why nothing is deleted; empty if the clock is plausible."""

    now: Utc
    trusted: Utc | None
    doubt: str


class ConfirmClockIn(In):
    """Confirmation of the server clock. ``seen``: the server time that was shown to the person who checked it."""

    seen: AwareDatetime = Field(strict=False)


class RetentionOut(RetentionIn):
    """Retention policy in force, with its forecast. ``waiting``: what the last removal would have deleted, if it waits
    for confirmation."""

    last_run: Utc | None
    waiting: str
    clock: ServerClockOut
    forecast: ForecastOut


class RemovalOut(Out):
    """What a removal at ``at`` would delete. ``frames_bytes``: of their pixels; ``to_thin``: packets to be thinned to
    one per minute; ``unusual``: why a person must confirm it, empty if it may run."""

    at: Utc
    frames: int
    frames_bytes: int
    packets: int
    to_thin: int
    events: int
    unusual: str


class ConfirmedIn(In):
    """Preview that was confirmed: of the policy in force, at time ``at``."""

    at: AwareDatetime = Field(strict=False)
    frames: int = Field(ge=0)
    frames_bytes: int = Field(ge=0)
    packets: int = Field(ge=0)
    to_thin: int = Field(ge=0)
    events: int = Field(ge=0)


class RunRetentionIn(In):
    """Request to run retention. ``confirmed``: required if the preview reports the removal as unusual."""

    confirmed: ConfirmedIn | None = None


class BackupOut(Out):
    """Backup. ``bytes``: of everything it refers to; content shared between backups is stored once on disk."""

    name: str
    created: Utc
    version: str
    schema_version: str
    kind: str
    bytes: int
    blobs: int
    captures: int


class FavouriteIn(In):
    """Whether retention must keep this frame."""

    favourite: bool

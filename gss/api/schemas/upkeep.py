"""Health, retention and backups."""

from __future__ import annotations

from pydantic import AwareDatetime, Field

from gss.api.schemas.base import In, Out, Utc
from gss.operations.upkeep.removal import ConfirmedRemoval
from gss.operations.upkeep.retention_policy import RetentionPolicy


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


class ForecastOut(Out):
    """Disk usage and its growth. ``bytes_per_day`` null: not enough data; ``full_in_days`` null: not enough data, or no
    growth."""

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
    """Server clock and the last trusted time. ``doubt``: why the clock is implausible and nothing is deleted; empty if
    the clock is plausible."""

    now: Utc
    trusted: Utc | None
    doubt: str


class ConfirmClockIn(In):
    """Confirmation of the server clock. ``seen``: server time that was displayed to the person who checked it."""

    seen: AwareDatetime = Field(strict=False)


class RetentionOut(RetentionPolicy):
    """Retention policy in force, with its forecast. ``waiting``: what the last removal would have deleted, if it waits
    for confirmation."""

    last_run: Utc | None
    waiting: str
    clock: ServerClockOut
    forecast: ForecastOut


class RemovalOut(Out):
    """Data that a removal at time ``at`` would delete. ``frames_bytes``: size of the pixels; ``to_thin``: packets to be
    thinned to one per minute; ``unusual``: why a person must confirm the removal, empty if no confirmation is
    needed."""

    at: Utc
    frames: int
    frames_bytes: int
    packets: int
    to_thin: int
    events: int
    unusual: str


class RunRetentionIn(In):
    """Request to run retention. ``confirmed``: required if the preview reports the removal as unusual."""

    confirmed: ConfirmedRemoval | None = None


class BackupOut(Out):
    """Backup. ``bytes``: total size of its content. Content shared between backups is stored only once on disk."""

    name: str
    created: Utc
    version: str
    schema_version: str
    kind: str
    bytes: int
    blobs: int
    captures: int


class FavouriteIn(In):
    """Favourite mark of a frame. Retention keeps the pixels of favourites."""

    favourite: bool

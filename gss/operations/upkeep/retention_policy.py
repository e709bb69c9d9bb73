"""The retention policy and the request of a removal."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from datetime import timedelta

from gss.domain.errors import BadInput
from gss.domain.json_object import JsonObject
from gss.operations.jobs import JobRequest
from gss.operations.upkeep.removal import Confirmed
from gss.store import choices
from gss.store.engine import Database

CHOICE = "retention"
DAY = timedelta(days=1)
MAX_DAYS, MAX_GB, MAX_MB = 36_500, 1_000_000.0, 100_000_000


@dataclass(frozen=True)
class Policy:
    """Limits of stored data; 0 means unlimited. ``frames_days``: maximum age of pixels; ``frames_gb``: maximum total size of
    pixels, the oldest are removed first; ``keep_frames``: number of latest frames whose pixels are never removed.
    ``telemetry_thin_days``: age from which only one packet per minute of each type is kept; ``telemetry_days``: maximum age of
    packets; ``events_days``: maximum age of events. ``captures_mb``: maximum size of raw captures, 0: as set by
    GSS_CAPTURE_KEEP_MB. ``backups_keep``: number of latest backups to keep."""

    frames_days: float = 0
    frames_gb: float = 0
    keep_frames: int = 100
    telemetry_thin_days: float = 0
    telemetry_days: float = 0
    events_days: float = 0
    captures_mb: int = 0
    backups_keep: int = 0

    def __post_init__(self) -> None:
        for rule in fields(self):
            value = getattr(self, rule.name)
            maximum = MAX_DAYS if rule.name.endswith("_days") else MAX_GB if rule.name.endswith("_gb") else MAX_MB
            if not 0 <= value <= maximum:
                raise BadInput(f"{rule.name} is out of range", expected=f"0 (unlimited) to {maximum:g}", got=str(value))
        if 0 < self.telemetry_days <= self.telemetry_thin_days:
            raise BadInput(
                "packets would be deleted before they can be thinned",
                expected=f"thinning before {self.telemetry_days:g} days",
                got=f"{self.telemetry_thin_days:g} days",
            )


@dataclass(frozen=True)
class RemovalJob(JobRequest):
    """Request of a removal. ``confirmed``: confirmation by a user, valid only for this job."""

    policy: Policy
    confirmed: Confirmed | None = None


def unconfirmed(request: RemovalJob) -> RemovalJob:
    """Return the request without its confirmation."""
    return replace(request, confirmed=None)


def stored_policy(database: Database) -> Policy:
    """Return the active policy."""
    value = retention_choice(database, CHOICE)
    names = {f.name for f in fields(Policy)}
    return Policy(**{k: v for k, v in value.items() if k in names})


def retention_choice(database: Database, name: str) -> JsonObject:
    """Return the stored values of a name; empty if none are stored."""
    with database.unit_of_work() as session:
        return next((dict(row.value) for row in choices.read(session, name) if row.name == name), {})

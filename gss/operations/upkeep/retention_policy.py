"""The retention policy and the request of a removal."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import timedelta
from typing import Self

from pydantic import Field, model_validator

from gss.domain.errors import BadInput
from gss.domain.json_object import JsonObject
from gss.operations.jobs import JobRequest
from gss.operations.requests import Request
from gss.operations.upkeep.removal import ConfirmedRemoval
from gss.store import choices
from gss.store.engine import Database

CHOICE = "retention"
DAY = timedelta(days=1)


class RetentionPolicy(Request):
    """Retention policy. A limit of 0 means that there is no limit."""

    frames_days: float = Field(
        default=0, ge=0, le=36_500, description="Age at which pixels are deleted; metadata and solutions are kept."
    )
    frames_gb: float = Field(
        default=0, ge=0, le=1e6, description="Total size above which the oldest pixels are deleted."
    )
    keep_frames: int = Field(
        default=100, ge=0, le=10**6, description="Number of latest frames whose pixels are always kept."
    )
    telemetry_thin_days: float = Field(
        default=0, ge=0, le=36_500, description="Age at which packets are thinned to one per minute."
    )
    telemetry_days: float = Field(default=0, ge=0, le=36_500, description="Age at which packets are deleted.")
    events_days: float = Field(default=0, ge=0, le=36_500, description="Age at which events are deleted.")
    captures_mb: int = Field(
        default=0, ge=0, le=10**8, description="Total size of the raw captures; 0: GSS_CAPTURE_KEEP_MB."
    )
    backups_keep: int = Field(default=0, ge=0, le=10**4, description="Number of latest backups to keep.")

    @model_validator(mode="after")
    def _check_order(self) -> Self:
        if 0 < self.telemetry_days <= self.telemetry_thin_days:
            raise BadInput(
                "packets would be deleted before they can be thinned",
                expected=f"thinning before {self.telemetry_days:g} days",
                got=f"{self.telemetry_thin_days:g} days",
            )
        return self

    @property
    def deletes(self) -> bool:
        """True if the daily run can delete data under this policy."""
        return any((self.frames_days, self.frames_gb, self.telemetry_thin_days, self.telemetry_days, self.events_days))


@dataclass(frozen=True)
class RemovalJob(JobRequest):
    """Request of a removal. ``confirmed``: confirmation by a user, valid only for this job."""

    policy: RetentionPolicy
    confirmed: ConfirmedRemoval | None = None


def unconfirmed(request: RemovalJob) -> RemovalJob:
    """Return the request without its confirmation."""
    return replace(request, confirmed=None)


def stored_policy(database: Database) -> RetentionPolicy:
    """Return the policy in force."""
    value = retention_choice(database, CHOICE)
    return RetentionPolicy(**{k: v for k, v in value.items() if k in RetentionPolicy.model_fields})


def retention_choice(database: Database, name: str) -> JsonObject:
    """Return the stored values of a name; empty if none are stored."""
    with database.unit_of_work() as session:
        return next((dict(row.value) for row in choices.read(session, name) if row.name == name), {})

"""States and kinds of jobs: which jobs can run again, and who can start and end them. Stored texts and requests."""

from __future__ import annotations

from gss.domain.errors import GssError
from gss.domain.json_object import JsonObject
from gss.store.models import Job

ENDED = ("done", "failed", "cancelled")
CANCELLING = "cancelling"
"""State of a started job whose cancellation was requested. It is stored, so that the next server does not continue the
job. The API reports it as running, because the job can still report progress."""
UNFINISHED = ("queued", "running", CANCELLING)
KINDS = (
    *("experiments", "campaign", "reprocess", "catalogue", "design", "calibration", "analysis", "lists", "instrument"),
    *("derive", "rehearsal", "backup", "retention", "check-store"),
)
"""Kinds of jobs that can run again with only their stored request. The service that runs the jobs of a kind registers
the kind."""
ALWAYS = ("retention", "check-store", "backup")
"""Kinds of jobs that are accepted even if the disk of the data is nearly full, because these jobs free space, only read, or
check another disk."""
PERMISSIONS = {
    "experiments": "campaigns",
    "campaign": "campaigns",
    "reprocess": "campaigns",
    "catalogue": "catalogues.build",
    "design": "analyse",
    "calibration": "calibrate",
    "analysis": "analyse",
    "lists": "frames.import",
    "instrument": "instruments",
    "derive": "derived",
    "rehearsal": "passes",
    "backup": "admin.backup",
    "retention": "admin.retention",
    "check-store": "admin.health",
}
"""Permission needed to start a job of a kind. The route that starts this kind of job requires the same permission."""
UNKNOWN_KIND = "admin.users"
"""Permission needed to start or end a job of an unknown kind: a permission of administrators."""


def can_start_again(job: Job) -> bool:
    """True if the job has ended and its kind is created from the stored request alone."""
    return job.state in ENDED and job.kind in KINDS


def permission_of(job: Job) -> str:
    """Return the permission needed to start or end this job. The user who started the job can end it without this
    permission."""
    return PERMISSIONS.get(job.kind, UNKNOWN_KIND)


def started_by(job: Job, user: str) -> bool:
    """True if this user started the job."""
    return job.request.get("user") == user


def reason_of(error: Exception) -> str:
    """Return the text of a job that failed with this error."""
    return error.sentences() if isinstance(error, GssError) else f"Internal error: {type(error).__name__}: {error}"


def nested_request(stored: JsonObject) -> JsonObject:
    """Convert a request that version 0.4 stored without its user to {"asked": request}."""
    return stored if "asked" in stored else {"asked": stored}

"""Background jobs."""

from __future__ import annotations

from typing import Annotated

from fastapi import Query

from gss.api import present
from gss.api.api_router import api_router
from gss.api.deps import App, AuditNote, CurrentUser, RowId, need
from gss.api.schemas.jobs import JobOut
from gss.operations.job_rules import permission_of, started_by

router = api_router("jobs", "/jobs")


@router.get("")
def list_jobs(
    app: App,
    limit: Annotated[int, Query(ge=1, le=500)] = 20,
    kind: Annotated[str, Query(max_length=30)] = "",
) -> list[JobOut]:
    """Jobs, newest first. ``kind``: only jobs of this kind."""
    return [present.records.job(row) for row in app.base.jobs.newest(limit, kind)]


@router.get("/{job_id}")
def read_job(app: App, job_id: RowId) -> JobOut:
    """Return one job."""
    return present.records.job(app.base.jobs.get(job_id))


@router.post("/{job_id}/cancel", dependencies=[need("jobs.cancel")])
def cancel_job(app: App, job_id: RowId, caller: CurrentUser, audit_note: AuditNote) -> JobOut:
    """Cancel a job. Allowed for the user who started it and for users who may start this kind of job."""
    job = app.base.jobs.get(job_id)
    audit_note(job.title)
    if not started_by(job, caller.name):
        caller.require(permission_of(job))
    return present.records.job(app.base.jobs.cancel(job_id))


@router.post("/{job_id}/again", status_code=202, dependencies=[need("jobs.cancel")])
def start_again(app: App, job_id: RowId, caller: CurrentUser, audit_note: AuditNote) -> JobOut:
    """Repeat an ended job from its stored request, as a new job. Needs the permission to start this kind of job. Values
    from the settings, for example the retention policy, are the current values."""
    job = app.base.jobs.get(job_id)
    audit_note(job.title)
    caller.require(permission_of(job))
    return present.records.job(app.base.jobs.again(job_id, user=caller.name))

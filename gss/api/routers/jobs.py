"""Long work."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query

from gss.api import present
from gss.api.deps import App, Deed, RowId, Who, need
from gss.api.schemas.jobs import JobOut
from gss.operations.jobs import permission_of, started_by

router = APIRouter(prefix="/jobs", tags=["jobs"])


@router.get("")
def list_jobs(app: App, limit: Annotated[int, Query(ge=1, le=500)] = 20) -> list[JobOut]:
    """Newest first."""
    return [present.records.job(row) for row in app.jobs.newest(limit)]


@router.get("/{job_id}")
def read_job(app: App, job_id: RowId) -> JobOut:
    """One job."""
    return present.records.job(app.jobs.get(job_id))


@router.post("/{job_id}/cancel", dependencies=[need("jobs.cancel")])
def cancel_job(app: App, job_id: RowId, who: Who, deed: Deed) -> JobOut:
    """Ask it to end: who started it may, and who may start its kind."""
    job = app.jobs.get(job_id)
    deed(job.title)
    if not started_by(job, who.name):
        who.require(permission_of(job))
    return present.records.job(app.jobs.cancel(job_id))


@router.post("/{job_id}/again", status_code=202, dependencies=[need("jobs.cancel")])
def start_again(app: App, job_id: RowId, who: Who, deed: Deed) -> JobOut:
    """Do an ended job anew from its stored request, a new job; for who may start its kind. What the request took from settings,
    such as the policy of a removal, is what they say now."""
    job = app.jobs.get(job_id)
    deed(job.title)
    who.require(permission_of(job))
    return present.records.job(app.jobs.again(job_id, user=who.name))

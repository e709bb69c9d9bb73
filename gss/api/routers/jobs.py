"""Long work."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query

from gss.api import present
from gss.api.deps import App, RowId, need
from gss.api.schemas.jobs import JobOut

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
def cancel_job(app: App, job_id: RowId) -> JobOut:
    """Ask it to end."""
    return present.records.job(app.jobs.cancel(job_id))


@router.post("/{job_id}/again", status_code=202, dependencies=[need("jobs.cancel")])
def start_again(app: App, job_id: RowId) -> JobOut:
    """Do an ended job anew from its stored request; a new job."""
    return present.records.job(app.jobs.again(job_id))

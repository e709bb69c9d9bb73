"""Background jobs."""

from __future__ import annotations

from sqlalchemy import select
from sqlalchemy.orm import Session

from gss.domain.errors import NotFound
from gss.domain.json_object import JsonObject
from gss.store.models import Job


def add(session: Session, job: Job) -> Job:
    """Store a job's row and give it its id."""
    session.add(job)
    session.flush()
    return job


def get(session: Session, job_id: int) -> Job:
    """Return the job with that id; NotFound if there is none."""
    row = session.get(Job, job_id)
    if row is None:
        raise NotFound("no such job", got=str(job_id))
    return row


def newest(session: Session, limit: int) -> list[Job]:
    """Return the newest jobs first."""
    return list(session.scalars(select(Job).order_by(Job.id.desc()).limit(limit)))


def keep(session: Session, job_id: int, checkpoint: JsonObject) -> None:
    """Store a job's checkpoint. It has made progress, so earlier crashes no longer count."""
    row = get(session, job_id)
    row.checkpoint, row.attempts = checkpoint, 0


def unfinished(session: Session) -> list[Job]:
    """Return jobs that the last server run left unfinished."""
    return list(session.scalars(select(Job).where(Job.state.in_(("queued", "running")))))


def newest_of_kind(session: Session, kind: str, limit: int) -> list[Job]:
    """Return the newest jobs of a kind first."""
    return list(session.scalars(select(Job).where(Job.kind == kind).order_by(Job.id.desc()).limit(limit)))

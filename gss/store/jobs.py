"""Jobs."""

from __future__ import annotations

from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from gss.domain.errors import NotFound
from gss.store.models import Job


def add(session: Session, job: Job) -> Job:
    """Store a job's row and give it its id."""
    session.add(job)
    session.flush()
    return job


def get(session: Session, job_id: int) -> Job:
    """The job of that id."""
    row = session.get(Job, job_id)
    if row is None:
        raise NotFound("no such job", got=str(job_id))
    return row


def newest(session: Session, limit: int) -> list[Job]:
    """Newest first."""
    return list(session.scalars(select(Job).order_by(Job.id.desc()).limit(limit)))


def keep(session: Session, job_id: int, checkpoint: dict[str, Any]) -> None:
    """Where the job goes on. It came further: deaths before no longer count against it."""
    row = get(session, job_id)
    row.checkpoint, row.attempts = checkpoint, 0


def unfinished(session: Session) -> list[Job]:
    """Jobs that the last server left open."""
    return list(session.scalars(select(Job).where(Job.state.in_(("queued", "running")))))

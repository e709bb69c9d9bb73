"""Background jobs."""

from __future__ import annotations

from collections.abc import Sequence

from sqlalchemy import select
from sqlalchemy.orm import Session

from gss.domain.errors import NotFound
from gss.domain.json_object import JsonObject
from gss.store.models import Job


def add(session: Session, job: Job) -> Job:
    """Store a job's row and assign its id."""
    session.add(job)
    session.flush()
    return job


def get(session: Session, job_id: int) -> Job:
    """Return the job with that id. Raises NotFound if it does not exist."""
    row = session.get(Job, job_id)
    if row is None:
        raise NotFound("no such job", got=str(job_id))
    return row


def newest(session: Session, limit: int, kind: str = "") -> list[Job]:
    """Return the latest jobs, newest first. ``kind``: only jobs of this kind."""
    jobs = select(Job).where(Job.kind == kind) if kind else select(Job)
    return list(session.scalars(jobs.order_by(Job.id.desc()).limit(limit)))


def keep(session: Session, job_id: int, checkpoint: JsonObject) -> None:
    """Store a job's checkpoint and reset its crash count, because a checkpoint is progress."""
    row = get(session, job_id)
    row.checkpoint, row.attempts = checkpoint, 0


def in_states(session: Session, states: Sequence[str]) -> list[Job]:
    """Return the jobs in one of these states, oldest first."""
    return list(session.scalars(select(Job).where(Job.state.in_(states)).order_by(Job.id)))

"""Uploaded lists of measured stars and their results."""

from __future__ import annotations

from sqlalchemy import select
from sqlalchemy.orm import Session

from gss.domain.errors import NotFound
from gss.store.models import ListRun


def add(session: Session, row: ListRun) -> ListRun:
    """Store a run, assign its id and return it."""
    session.add(row)
    session.flush()
    return row


def get(session: Session, run_id: int) -> ListRun:
    """Return the run with that id. Raises NotFound."""
    row = session.get(ListRun, run_id)
    if row is None:
        raise NotFound("there is no star list run with this number", got=str(run_id), hint="upload the file first")
    return row


def finish(session: Session, run_id: int, *, solved: int, sha256: str, size: int) -> None:
    """Store the results of a run."""
    row = get(session, run_id)
    row.solved, row.results_sha256, row.results_size = solved, sha256, size


def newest(session: Session, limit: int) -> list[ListRun]:
    """Return the latest runs, newest first."""
    return list(session.scalars(select(ListRun).order_by(ListRun.id.desc()).limit(limit)))


def remove(session: Session, run_id: int) -> list[str]:
    """Delete a run and return the keys of its blobs. Other rows can refer to the same blobs. Raises NotFound."""
    row = get(session, run_id)
    session.delete(row)
    session.flush()
    return [key for key in (row.sha256, row.results_sha256) if key]

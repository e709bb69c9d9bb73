"""Procedures and their runs."""

from __future__ import annotations

from datetime import datetime

from sqlalchemy import select, update
from sqlalchemy.orm import Session

from gss.domain.errors import NotFound
from gss.store.models import Command, Procedure, ProcedureRun

RUNNING = "running"


def list_all(session: Session) -> list[Procedure]:
    """Return all procedures, sorted by name."""
    return list(session.scalars(select(Procedure).order_by(Procedure.name)))


def get(session: Session, procedure_id: int, *, lock: bool = False) -> Procedure:
    """Return the procedure with that id. Raises NotFound if it does not exist. ``lock``: prevent changes by other
    transactions until the end of this transaction, if the database supports it."""
    row = session.get(Procedure, procedure_id, with_for_update=lock)
    if row is None:
        raise NotFound("There is no such procedure", got=str(procedure_id))
    return row


def named(session: Session, name: str) -> Procedure | None:
    """Return the procedure with that name."""
    return session.scalar(select(Procedure).where(Procedure.name == name))


def add(session: Session, row: Procedure | ProcedureRun) -> None:
    """Store a new row and assign its id."""
    session.add(row)
    session.flush()


def delete(session: Session, procedure_id: int) -> None:
    """Delete a procedure. The records of its runs are kept."""
    row = get(session, procedure_id)
    session.execute(update(ProcedureRun).where(ProcedureRun.procedure_id == procedure_id).values(procedure_id=None))
    session.delete(row)


def get_run(session: Session, run_id: int) -> ProcedureRun:
    """Return the run with that id. Raises NotFound if it does not exist."""
    row = session.get(ProcedureRun, run_id)
    if row is None:
        raise NotFound("There is no such run of a procedure", got=str(run_id))
    return row


def newest_runs(
    session: Session, limit: int, procedure_id: int | None = None, before: int | None = None
) -> list[ProcedureRun]:
    """Return the latest runs, newest first. ``procedure_id``: only runs of this procedure; ``before``: only runs started
    before the run with this id."""
    query = select(ProcedureRun)
    if procedure_id is not None:
        query = query.where(ProcedureRun.procedure_id == procedure_id)
    if before is not None:
        query = query.where(ProcedureRun.id < before)
    return list(session.scalars(query.order_by(ProcedureRun.id.desc()).limit(limit)))


def running(session: Session) -> ProcedureRun | None:
    """Return the active run; None if there is none."""
    return session.scalar(select(ProcedureRun).where(ProcedureRun.state == RUNNING).order_by(ProcedureRun.id))


def between(session: Session, start: datetime, end: datetime) -> list[ProcedureRun]:
    """Return the runs that overlap a time range, oldest first."""
    row = ProcedureRun
    query = select(row).where(row.started <= end, (row.finished.is_(None)) | (row.finished >= start))
    return list(session.scalars(query.order_by(row.id)))


def first_command(session: Session, run_id: int, since: datetime) -> Command | None:
    """Return the first command of a run that was stored at or after ``since``."""
    query = select(Command).where(Command.run_id == run_id, Command.created >= since)
    return session.scalar(query.order_by(Command.id).limit(1))

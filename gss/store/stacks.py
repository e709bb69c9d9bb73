"""Command stacks and their runs."""

from __future__ import annotations

from sqlalchemy import select, update
from sqlalchemy.orm import Session

from gss.domain.errors import NotFound
from gss.store.models import Stack, StackRun

UNFINISHED = ("running", "paused")


def every(session: Session) -> list[Stack]:
    """Return all stacks, sorted by name."""
    return list(session.scalars(select(Stack).order_by(Stack.name)))


def get(session: Session, stack_id: int) -> Stack:
    """Return the stack with that id. Raises NotFound if it does not exist."""
    row = session.get(Stack, stack_id)
    if row is None:
        raise NotFound("no such stack", got=str(stack_id))
    return row


def named(session: Session, name: str) -> Stack | None:
    """Return the stack with that name."""
    return session.scalar(select(Stack).where(Stack.name == name))


def add(session: Session, row: Stack | StackRun) -> None:
    """Store a new row and assign its id."""
    session.add(row)
    session.flush()


def delete(session: Session, stack_id: int) -> None:
    """Delete a stack. The records of its runs are kept."""
    row = get(session, stack_id)
    session.execute(update(StackRun).where(StackRun.stack_id == stack_id).values(stack_id=None))
    session.delete(row)


def get_run(session: Session, run_id: int) -> StackRun:
    """Return the run with that id. Raises NotFound if it does not exist."""
    row = session.get(StackRun, run_id)
    if row is None:
        raise NotFound("no such stack run", got=str(run_id))
    return row


def newest_runs(session: Session, limit: int) -> list[StackRun]:
    """Return the newest runs, newest first."""
    return list(session.scalars(select(StackRun).order_by(StackRun.id.desc()).limit(limit)))


def unfinished_runs(session: Session) -> list[StackRun]:
    """Return stack runs that the previous run of the server left unfinished."""
    return list(session.scalars(select(StackRun).where(StackRun.state.in_(UNFINISHED))))

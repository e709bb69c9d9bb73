"""Shared views of the console."""

from __future__ import annotations

from sqlalchemy import delete, func, select
from sqlalchemy.orm import Session

from gss.domain.errors import NotFound
from gss.store.models import SharedView, SharedViewVersion


def list_all(session: Session) -> list[SharedView]:
    """Return all views, sorted by name."""
    return list(session.scalars(select(SharedView).order_by(SharedView.name)))


def count(session: Session) -> int:
    """Return the number of views."""
    return session.scalar(select(func.count()).select_from(SharedView)) or 0


def get(session: Session, view_id: int, *, lock: bool = False) -> SharedView:
    """Return the view with that id. Raises NotFound if it does not exist. ``lock``: prevent changes by other
    transactions until the end of this transaction, if the database supports it."""
    row = session.get(SharedView, view_id, with_for_update=lock)
    if row is None:
        raise NotFound("There is no such view", got=str(view_id))
    return row


def named(session: Session, name: str) -> SharedView | None:
    """Return the view with that name."""
    return session.scalar(select(SharedView).where(SharedView.name == name))


def add(session: Session, row: SharedView | SharedViewVersion) -> None:
    """Store a new row and assign its id."""
    session.add(row)
    session.flush()


def versions(session: Session, view_id: int) -> list[SharedViewVersion]:
    """Return the versions of a view, newest first."""
    query = select(SharedViewVersion).where(SharedViewVersion.view_id == view_id)
    return list(session.scalars(query.order_by(SharedViewVersion.version.desc())))


def forget_versions(session: Session, view_id: int, before: int) -> None:
    """Delete the versions of a view before version ``before``."""
    row = SharedViewVersion
    session.execute(delete(row).where(row.view_id == view_id, row.version < before))


def remove(session: Session, row: SharedView) -> None:
    """Delete a view with its versions."""
    session.execute(delete(SharedViewVersion).where(SharedViewVersion.view_id == row.id))
    session.delete(row)

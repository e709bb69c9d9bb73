"""Imported star lists."""

from __future__ import annotations

from sqlalchemy import select
from sqlalchemy.orm import Session

from gss.domain.errors import NotFound
from gss.store.models import StarList


def add(session: Session, row: StarList) -> StarList:
    """Store a list's row and assign its id."""
    session.add(row)
    session.flush()
    return row


def get(session: Session, list_id: int) -> StarList:
    """Return the list with that id. Raises NotFound if it does not exist."""
    row = session.get(StarList, list_id)
    if row is None:
        raise NotFound("no such star list", got=str(list_id), hint="upload it first")
    return row


def newest(session: Session, limit: int) -> list[StarList]:
    """Return the latest lists, newest first."""
    return list(session.scalars(select(StarList).order_by(StarList.id.desc()).limit(limit)))

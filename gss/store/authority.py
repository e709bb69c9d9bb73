"""Holders of command authority, current and past."""

from __future__ import annotations

from datetime import datetime

from sqlalchemy import select
from sqlalchemy.orm import Session

from gss.store.models import Authority


def holder(session: Session) -> Authority | None:
    """Return the open row; None if no user holds authority."""
    return session.scalar(select(Authority).where(Authority.ended.is_(None)).order_by(Authority.id.desc()).limit(1))


def take(session: Session, user: str, at: datetime) -> Authority:
    """Store a new open row."""
    row = Authority(holder=user, taken=at, ended=None, ended_by="", reason="")
    session.add(row)
    session.flush()
    return row


def end(session: Session, row: Authority, at: datetime, by: str, reason: str) -> None:
    """Close a row. A pending transfer of authority is removed."""
    row.ended, row.ended_by, row.reason = at, by, reason
    put_transfer(session, row, "", "", "", None)
    session.add(row)


def put_transfer(session: Session, row: Authority, kind: str, user: str, note: str, at: datetime | None) -> None:
    """Store a request or an offer of the row's authority; an empty ``kind`` removes it."""
    row.transfer, row.transfer_user, row.transfer_note, row.transfer_at = kind, user, note, at
    session.add(row)


def newest(session: Session, limit: int) -> list[Authority]:
    """Return the latest rows, newest first."""
    return list(session.scalars(select(Authority).order_by(Authority.id.desc()).limit(limit)))

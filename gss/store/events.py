"""Recorded events."""

from __future__ import annotations

from datetime import datetime

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from gss.domain.json_object import JsonObject
from gss.store.models import Event


def add(session: Session, at: datetime, kind: str, severity: str, text: str, data: JsonObject) -> Event:
    """Append one event."""
    row = Event(at=at, kind=kind, severity=severity, text=text, data=data)
    session.add(row)
    session.flush()
    return row


def after(session: Session, seq: int, limit: int) -> list[Event]:
    """Return events after ``seq``, oldest first."""
    return list(session.scalars(select(Event).where(Event.seq > seq).order_by(Event.seq).limit(limit)))


def between(session: Session, start: datetime, end: datetime, limit: int) -> list[Event]:
    """Return the newest ``limit`` events of a time range, oldest first."""
    query = select(Event).where(Event.at >= start, Event.at <= end).order_by(Event.seq.desc()).limit(limit)
    return list(session.scalars(query))[::-1]


def last_seq(session: Session) -> int:
    """Return the number of the newest event; 0 if there is none."""
    return session.scalar(select(func.max(Event.seq))) or 0

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


def between(
    session: Session, start: datetime | None, end: datetime | None, limit: int, seq: int | None = None
) -> list[Event]:
    """Return events of a time range with any end, oldest first: the first ``limit`` after ``seq``, or the newest ``limit``
    without ``seq``."""
    query = select(Event).limit(limit).order_by(Event.seq.desc() if seq is None else Event.seq)
    if start is not None:
        query = query.where(Event.at >= start)
    if end is not None:
        query = query.where(Event.at <= end)
    if seq is not None:
        return list(session.scalars(query.where(Event.seq > seq)))
    return list(session.scalars(query))[::-1]


def of_alarm(session: Session, alarm_id: int, start: datetime) -> list[Event]:
    """Return the events of an alarm from ``start`` on, oldest first."""
    own = (Event.at >= start, Event.kind == "alarm", Event.data["alarm_id"].as_integer() == alarm_id)
    return list(session.scalars(select(Event).where(*own).order_by(Event.seq)))


def last_seq(session: Session) -> int:
    """Return the number of the newest event; 0 if there is none."""
    return session.scalar(select(func.max(Event.seq))) or 0

"""Open and closed alarms."""

from __future__ import annotations

from datetime import datetime

from sqlalchemy import select
from sqlalchemy.orm import Session

from gss.domain.errors import NotFound
from gss.store.models import Alarm


def add(session: Session, alarm: Alarm) -> Alarm:
    """Store an alarm and assign its id."""
    session.add(alarm)
    session.flush()
    return alarm


def get(session: Session, alarm_id: int) -> Alarm:
    """Return the alarm with that id. Raises NotFound if it does not exist."""
    row = session.get(Alarm, alarm_id)
    if row is None:
        raise NotFound("no such alarm", got=str(alarm_id))
    return row


def set_value(session: Session, alarm_id: int, value: float) -> Alarm:
    """Replace the value of an alarm."""
    row = get(session, alarm_id)
    row.value = value
    return row


def still_open(session: Session) -> list[Alarm]:
    """Return alarms that are not closed, oldest first."""
    return list(session.scalars(select(Alarm).where(Alarm.closed.is_(None)).order_by(Alarm.id)))


def newest(session: Session, limit: int) -> list[Alarm]:
    """Return the latest alarms, including closed alarms, newest first."""
    return list(session.scalars(select(Alarm).order_by(Alarm.id.desc()).limit(limit)))


def between(session: Session, start: datetime, end: datetime) -> list[Alarm]:
    """Return the alarms that were open at any time in a time range, oldest first."""
    query = (
        select(Alarm).where(Alarm.raised <= end, Alarm.closed.is_(None) | (Alarm.closed >= start)).order_by(Alarm.id)
    )
    return list(session.scalars(query))

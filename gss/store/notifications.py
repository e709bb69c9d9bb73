"""Notifications, which are created once per key, sent, and kept as a record."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

from sqlalchemy import delete, select, update
from sqlalchemy.orm import Session

from gss.store.models import Notification


def newest(session: Session, limit: int) -> list[Notification]:
    """Return the latest rows, newest first."""
    return list(session.scalars(select(Notification).order_by(Notification.id.desc()).limit(limit)))


def states_by_key(session: Session, keys: Sequence[str]) -> dict[str, str]:
    """Return the states of the stored notifications with these keys, by key."""
    states: dict[str, str] = {}
    query = select(Notification.key, Notification.state)
    for k in range(0, len(keys), 500):
        states |= {row.key: row.state for row in session.execute(query.where(Notification.key.in_(keys[k : k + 500])))}
    return states


def of_keys(session: Session, keys: Sequence[str]) -> list[Notification]:
    """Return the stored notifications with these keys."""
    rows: list[Notification] = []
    for k in range(0, len(keys), 500):
        rows += session.scalars(select(Notification).where(Notification.key.in_(keys[k : k + 500])))
    return rows


def of_ids(session: Session, ids: Sequence[int]) -> list[Notification]:
    """Return the notifications with these ids."""
    return list(session.scalars(select(Notification).where(Notification.id.in_(ids))))


def take_due(session: Session, target: str, now: datetime) -> list[Notification]:
    """Return up to 500 notifications of a target that are due, mark them as sending, and count the attempt."""
    due = (Notification.target == target, Notification.state == "pending", Notification.due <= now)
    rows = list(session.scalars(select(Notification).where(*due).order_by(Notification.id).limit(500)))
    for row in rows:
        row.state, row.tries = "sending", row.tries + 1
    return rows


def waiting(session: Session, now: datetime) -> list[Notification]:
    """Return the pending notifications that are not due yet."""
    return list(session.scalars(select(Notification).where(Notification.state == "pending", Notification.due > now)))


def withdraw_others(session: Session, alarm_ids: Sequence[int], now: datetime) -> None:
    """Withdraw the pending notifications of all alarms except ``alarm_ids``."""
    session.execute(
        update(Notification)
        .where(Notification.state == "pending", Notification.alarm_id.is_not(None))
        .where(Notification.alarm_id.not_in(alarm_ids))
        .values(state="withdrawn", finished=now, problem="acknowledged, shelved or closed before it was sent")
    )


def lose_sending(session: Session, now: datetime) -> None:
    """Mark notifications as unknown whose sending was interrupted by the end of the server."""
    session.execute(
        update(Notification)
        .where(Notification.state == "sending")
        .values(state="unknown", finished=now, problem="the server ended while it was being sent; it is not sent again")
    )


def prune(session: Session, before: datetime) -> None:
    """Delete notifications that were finished before a time."""
    session.execute(delete(Notification).where(Notification.finished < before))

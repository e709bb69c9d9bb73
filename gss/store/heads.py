"""Spacecraft with several heads, and the history of their comparison."""

from __future__ import annotations

from collections.abc import Iterable
from datetime import datetime

from sqlalchemy import delete, func, select
from sqlalchemy.orm import Session

from gss.domain.errors import NotFound
from gss.store.models import FusedRow, HeadPairRow, Spacecraft


def list_all(session: Session) -> list[Spacecraft]:
    """Return all spacecraft, sorted by name."""
    return list(session.scalars(select(Spacecraft).order_by(Spacecraft.name)))


def get(session: Session, spacecraft_id: int) -> Spacecraft:
    """Return the spacecraft with that id. Raises NotFound if it does not exist."""
    row = session.get(Spacecraft, spacecraft_id)
    if row is None:
        raise NotFound("no such spacecraft", got=str(spacecraft_id))
    return row


def exists(session: Session, spacecraft_id: int) -> bool:
    """True if the spacecraft is stored."""
    return session.get(Spacecraft, spacecraft_id) is not None


def add(session: Session, row: Spacecraft) -> None:
    """Store a new spacecraft and assign its id."""
    session.add(row)
    session.flush()


def remove(session: Session, spacecraft_id: int) -> None:
    """Delete a spacecraft with its history. Raises NotFound."""
    row = get(session, spacecraft_id)
    for table in (FusedRow, HeadPairRow):
        session.execute(delete(table).where(table.spacecraft_id == spacecraft_id))
    session.delete(row)


def add_results(session: Session, rows: Iterable[FusedRow | HeadPairRow]) -> None:
    """Store fused attitudes and comparisons of heads."""
    session.add_all(rows)


def delete_before(session: Session, time: datetime) -> None:
    """Delete results older than ``time``."""
    for table in (FusedRow, HeadPairRow):
        session.execute(delete(table).where(table.at < time))


def newest_pair(session: Session, spacecraft_id: int, unit: str, since: datetime) -> HeadPairRow | None:
    """Return the newest comparison of a unit at or after ``since``."""
    query = (
        select(HeadPairRow)
        .where(HeadPairRow.spacecraft_id == spacecraft_id, HeadPairRow.unit == unit, HeadPairRow.at >= since)
        .order_by(HeadPairRow.at.desc())
        .limit(1)
    )
    return session.scalar(query)


def newest_fused(session: Session, spacecraft_id: int) -> FusedRow | None:
    """Return the newest fused attitude."""
    query = select(FusedRow).where(FusedRow.spacecraft_id == spacecraft_id).order_by(FusedRow.at.desc()).limit(1)
    return session.scalar(query)


def fused_between(session: Session, spacecraft_id: int, start: datetime, end: datetime, limit: int) -> list[FusedRow]:
    """Return the fused attitudes of a time range, oldest first, at most ``limit``."""
    query = select(FusedRow).where(FusedRow.spacecraft_id == spacecraft_id, FusedRow.at.between(start, end))
    return list(session.scalars(query.order_by(FusedRow.at, FusedRow.id).limit(limit)))


def pairs_between(
    session: Session, spacecraft_id: int, start: datetime, end: datetime, limit: int
) -> list[HeadPairRow]:
    """Return the comparisons of a time range, oldest first. If there are more than ``limit``, return every n-th
    comparison of each unit."""
    row = HeadPairRow
    within = (row.spacecraft_id == spacecraft_id, row.at.between(start, end))
    count = session.scalar(select(func.count()).select_from(row).where(*within)) or 0
    number = func.row_number().over(partition_by=row.unit, order_by=row.at)
    numbered = select(row.id, number.label("n")).where(*within).subquery()
    query = select(row).join(numbered, numbered.c.id == row.id)
    return list(session.scalars(query.where(numbered.c.n % max(1, -(-count // limit)) == 0).order_by(row.at)))

"""Definitions of derived parameters, and their computed history."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from datetime import datetime, timedelta
from typing import Any

from sqlalchemy import delete as delete_rows
from sqlalchemy import func, insert, select
from sqlalchemy.orm import Session

from gss.domain.errors import NotFound
from gss.store import rollups
from gss.store.models import DerivedParameter, TelemetryPacket


def list_all(session: Session) -> list[DerivedParameter]:
    """Return all definitions, sorted by name."""
    return list(session.scalars(select(DerivedParameter).order_by(DerivedParameter.name)))


def named(session: Session, name: str) -> DerivedParameter:
    """Return the definition of that name. Raises NotFound if it does not exist."""
    row = session.scalar(select(DerivedParameter).where(DerivedParameter.name == name))
    if row is None:
        raise NotFound("There is no such derived parameter", got=name)
    return row


def add(session: Session, row: DerivedParameter) -> None:
    """Store a new definition and assign its id."""
    session.add(row)
    session.flush()


def delete(session: Session, row: DerivedParameter) -> None:
    """Delete a definition. Its history is kept."""
    session.delete(row)


def first_received(session: Session, packets: Sequence[str], start: datetime, end: datetime) -> datetime | None:
    """Return the reception time of the first packet of these kinds in a time range, excluding its end; None if there is
    none."""
    row = TelemetryPacket
    return session.scalar(
        select(func.min(row.received)).where(row.packet.in_(packets), row.received >= start, row.received < end)
    )


def last_received(session: Session, packet: str, before: datetime) -> datetime | None:
    """Return the reception time of the last packet of a kind before a time; None if there is none."""
    row = TelemetryPacket
    return session.scalar(select(func.max(row.received)).where(row.packet == packet, row.received < before))


def replace(session: Session, packet: str, start: datetime, end: datetime, rows: Sequence[Mapping[str, Any]]) -> None:
    """Replace the packets of one kind in a time range, excluding its end, and mark the rollups of the range as
    incomplete."""
    row = TelemetryPacket
    session.execute(delete_rows(row).where(row.packet == packet, row.received >= start, row.received < end))
    if rows:
        session.execute(insert(row.__table__), rows)  # type: ignore[arg-type]  # declared as FromClause
    for hour in range(rollups.hour_of(start), rollups.hour_of(end - timedelta(microseconds=1)) + 1):
        rollups.undo(session, [packet], hour)

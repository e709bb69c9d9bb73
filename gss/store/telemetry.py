"""Telemetry packets: batches in, spans out."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

from sqlalchemy import select
from sqlalchemy.orm import Session

from gss.store.models import TelemetryPacket


def add_batch(session: Session, packets: Sequence[TelemetryPacket]) -> None:
    """Store packets in one transaction."""
    session.add_all(packets)


def span(
    session: Session, packet: str, fields: Sequence[str], start: datetime, end: datetime
) -> list[tuple[datetime, list[float | None]]]:
    """(received, values) of the given numeric fields, oldest first, both ends included."""
    columns = [TelemetryPacket.values[name].as_float() for name in fields]
    query = (
        select(TelemetryPacket.received, *columns)
        .where(TelemetryPacket.packet == packet, TelemetryPacket.received >= start, TelemetryPacket.received <= end)
        .order_by(TelemetryPacket.received)
    )
    return [(row[0], list(row[1:])) for row in session.execute(query)]


def newest(session: Session, packet: str, limit: int) -> list[TelemetryPacket]:
    """Newest packets of one kind first."""
    query = (
        select(TelemetryPacket)
        .where(TelemetryPacket.packet == packet)
        .order_by(TelemetryPacket.received.desc(), TelemetryPacket.id.desc())
        .limit(limit)
    )
    return list(session.scalars(query))

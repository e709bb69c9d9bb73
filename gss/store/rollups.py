"""Rollups of telemetry: an hour of a field per row, and a row without a field that says that the hour is done."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from typing import Any

from sqlalchemy import delete, func, insert, select
from sqlalchemy.orm import Session

from gss.store.models import TelemetryPacket, TelemetryRollup

HOUR_S = 3600
DONE = ""
"""Field of the row that says that an hour is done."""


def start_of(hour: int) -> datetime:
    """The moment at which an hour, counted from 1970, begins."""
    return datetime.fromtimestamp(hour * HOUR_S, UTC)


def hour_of(moment: datetime) -> int:
    """The hour of a moment."""
    return int(moment.timestamp() // HOUR_S)


def done_hours(session: Session, packet: str, first: int, last: int) -> list[int]:
    """Hours of a span that are done, both ends included, in order."""
    key = TelemetryRollup
    query = select(key.hour).where(key.packet == packet, key.field == DONE, key.hour.between(first, last))
    return list(session.scalars(query.order_by(key.hour)))


def newest_hour(session: Session, packet: str) -> int | None:
    """The newest hour of a packet that is done."""
    key = TelemetryRollup
    return session.scalar(select(func.max(key.hour)).where(key.packet == packet, key.field == DONE))


def of_fields(
    session: Session, packet: str, fields: Sequence[str], first: int, last: int
) -> Iterator[tuple[int, str, bytes]]:
    """(hour, field, data) of some fields in a span of hours, hour by hour."""
    key = TelemetryRollup
    query = select(key.hour, key.field, key.data).where(key.packet == packet, key.field.in_(fields))
    for hour, field, data in session.execute(query.where(key.hour.between(first, last)).order_by(key.hour)):
        yield int(hour), field, data


def next_received(session: Session, packet: str, at: datetime) -> datetime | None:
    """When the first packet of a kind came at or after a moment."""
    row = TelemetryPacket
    return session.scalar(select(func.min(row.received)).where(row.packet == packet, row.received >= at))


def packets_of(session: Session, packet: str, hour: int) -> list[tuple[datetime, dict[str, Any]]]:
    """(received, values) of an hour, oldest first."""
    row = TelemetryPacket
    query = (
        select(row.received, row.values)
        .where(row.packet == packet, row.received >= start_of(hour), row.received < start_of(hour + 1))
        .order_by(row.received, row.id)
    )
    return [(at, values) for at, values in session.execute(query)]


def keep(session: Session, packet: str, hour: int, data: Mapping[str, bytes], read: int) -> bool:
    """Store an hour, in place of what was; False, and nothing is stored, where other packets came since ``read`` were read."""
    key, row = TelemetryRollup, TelemetryPacket
    session.execute(delete(key).where(key.packet == packet, key.field.in_([DONE, *data]), key.hour == hour))
    rows = [{"packet": packet, "field": field, "hour": hour, "data": packed} for field, packed in data.items()]
    rows.append({"packet": packet, "field": DONE, "hour": hour, "data": b""})
    session.execute(insert(key), rows)
    span = (row.received >= start_of(hour), row.received < start_of(hour + 1))
    if session.scalar(select(func.count()).select_from(row).where(row.packet == packet, *span)) != read:
        session.rollback()
        return False
    return True


def undo(session: Session, packets: Iterable[str], hour: int) -> None:
    """An hour is not done any more: packets came late."""
    key = TelemetryRollup
    session.execute(delete(key).where(key.packet.in_(list(packets)), key.field == DONE, key.hour == hour))

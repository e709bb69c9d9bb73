"""Telemetry rollups. Each field has one row per hour; a row without a field marks the hour as complete."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime

from sqlalchemy import delete, func, insert, select
from sqlalchemy.orm import Session

from gss.domain.json_object import JsonObject
from gss.store.models import TelemetryPacket, TelemetryRollup

HOUR_S = 3600
DONE = ""
"""Field of the row that marks an hour as complete."""


def start_of(hour: int) -> datetime:
    """Return the start of an hour, counted from 1970."""
    return datetime.fromtimestamp(hour * HOUR_S, UTC)


def hour_of(time: datetime) -> int:
    """Return the hour of a time, counted from 1970."""
    return int(time.timestamp() // HOUR_S)


def done_hours(session: Session, packet: str, first: int, last: int) -> list[int]:
    """Return the complete hours from ``first`` to ``last`` inclusive, in ascending order."""
    key = TelemetryRollup
    query = select(key.hour).where(key.packet == packet, key.field == DONE, key.hour.between(first, last))
    return list(session.scalars(query.order_by(key.hour)))


def newest_hour(session: Session, packet: str) -> int | None:
    """Return the newest complete hour of a packet."""
    key = TelemetryRollup
    return session.scalar(select(func.max(key.hour)).where(key.packet == packet, key.field == DONE))


def of_fields(
    session: Session, packet: str, fields: Sequence[str], first: int, last: int
) -> Iterator[tuple[int, str, bytes]]:
    """Yield (hour, field, data) of the fields from hour ``first`` to ``last``, sorted by hour."""
    key = TelemetryRollup
    query = select(key.hour, key.field, key.data).where(key.packet == packet, key.field.in_(fields))
    for hour, field, data in session.execute(query.where(key.hour.between(first, last)).order_by(key.hour)):
        yield int(hour), field, data


def next_received(session: Session, packet: str, at: datetime) -> datetime | None:
    """Return the reception time of the first packet of a kind at or after a time."""
    row = TelemetryPacket
    return session.scalar(select(func.min(row.received)).where(row.packet == packet, row.received >= at))


def packets_of(session: Session, packet: str, start: datetime, end: datetime) -> list[tuple[datetime, JsonObject]]:
    """Return (received, values) of the packets received from ``start`` to before ``end``, oldest first."""
    row = TelemetryPacket
    query = (
        select(row.received, row.values)
        .where(row.packet == packet, row.received >= start, row.received < end)
        .order_by(row.received, row.id)
    )
    return [(at, values) for at, values in session.execute(query)]


def keep(session: Session, packet: str, hour: int, data: Mapping[str, bytes], read: int) -> bool:
    """Store the rollup of an hour, replacing earlier data. ``read``: number of packets used. If the number of stored
    packets has changed, roll back and return False."""
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
    """Mark an hour as incomplete, because packets were added later."""
    key = TelemetryRollup
    session.execute(delete(key).where(key.packet.in_(list(packets)), key.field == DONE, key.hour == hour))

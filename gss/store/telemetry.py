"""Telemetry packets, which are stored in batches and read in blocks."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from datetime import datetime
from typing import Any, NamedTuple

from sqlalchemy import JSON, ColumnElement, String, func, insert, literal, select
from sqlalchemy.orm import Session

from gss.store.engine import Database
from gss.store.models import TelemetryPacket

BLOCK_ROWS = 4000


class Row(NamedTuple):
    """One packet. ``values``: values of the requested fields in the requested order."""

    received: datetime
    id: int
    packet: str
    device_time_s: float
    contact_id: int | None
    values: tuple[Any, ...]


def add_batch(session: Session, packets: Sequence[TelemetryPacket]) -> None:
    """Store packets in one transaction."""
    session.add_all(packets)


def add_many(session: Session, rows: Sequence[Mapping[str, Any]]) -> None:
    """Store packets in one statement without creating objects. ``rows``: column values of each packet."""
    session.execute(insert(TelemetryPacket.__table__), rows)  # type: ignore[arg-type]  # declared as FromClause


def rows(
    database: Database,
    packet: str,
    names: Sequence[str],
    start: datetime,
    end: datetime,
    *,
    contact_id: int | None = None,
    unsolicited: bool = False,
    block: int = BLOCK_ROWS,
) -> Iterator[Row]:
    """Yield the packets of a time range, oldest first, including both ends. At most ``block`` packets are in memory,
    and no transaction stays open between blocks."""
    columns = [_value(name) for name in names]
    query = (
        select(
            TelemetryPacket.received,
            TelemetryPacket.id,
            TelemetryPacket.device_time_s,
            TelemetryPacket.contact_id,
            *columns,
        )
        .where(TelemetryPacket.packet == packet, TelemetryPacket.received <= end)
        .order_by(TelemetryPacket.received, TelemetryPacket.id)
        .limit(block)
    )
    if contact_id is not None:
        query = query.where(TelemetryPacket.contact_id == contact_id)
    if unsolicited:
        query = query.where(TelemetryPacket.request_id == 0)
    at, row_id = start, -1
    while True:
        later = TelemetryPacket.received > at
        same = (TelemetryPacket.received == at) & (TelemetryPacket.id > row_id)
        with database.unit_of_work() as session:
            result_rows = session.execute(query.where(TelemetryPacket.received >= at, later | same)).all()
        for row in result_rows:
            yield Row(row[0], row[1], packet, row[2], row[3], tuple(row[4:]))
        if len(result_rows) < block:
            return
        at, row_id = result_rows[-1][0], result_rows[-1][1]


def _value(name: str) -> ColumnElement[Any]:
    """Return the column expression for a field of a packet's values. The operator -> exists in both databases and
    preserves all digits of a number. SQLAlchemy's function for SQLite preserves only fifteen digits."""
    if sqlite3.sqlite_version_info < (3, 38):
        return TelemetryPacket.values[name]
    return TelemetryPacket.values.op("->", return_type=JSON())(literal(name, String()))


def newest(session: Session, packet: str, limit: int) -> list[TelemetryPacket]:
    """Return the latest packets of one kind, newest first."""
    query = (
        select(TelemetryPacket)
        .where(TelemetryPacket.packet == packet)
        .order_by(TelemetryPacket.received.desc(), TelemetryPacket.id.desc())
        .limit(limit)
    )
    return list(session.scalars(query))


def page(
    session: Session,
    packet: str | None,
    start: datetime | None,
    end: datetime | None,
    limit: int,
    before_id: int | None,
    contact_id: int | None = None,
    after_id: int | None = None,
) -> list[TelemetryPacket]:
    """Return a page of packets, newest first; ``before_id`` is the last id of the previous page. With ``after_id``,
    return the packets with larger ids, oldest first."""
    order = TelemetryPacket.id.desc() if after_id is None else TelemetryPacket.id
    query = select(TelemetryPacket).order_by(order).limit(limit)
    columns = (
        (TelemetryPacket.packet, packet, "__eq__"),
        (TelemetryPacket.contact_id, contact_id, "__eq__"),
        (TelemetryPacket.received, start, "__ge__"),
        (TelemetryPacket.received, end, "__le__"),
        (TelemetryPacket.id, before_id, "__lt__"),
        (TelemetryPacket.id, after_id, "__gt__"),
    )
    for column, value, compare in columns:
        if value is not None:
            query = query.where(getattr(column, compare)(value))
    return list(session.scalars(query))


def counts(session: Session, contact_id: int) -> dict[str, int]:
    """Return the number of stored packets of each kind for a contact."""
    query = (
        select(TelemetryPacket.packet, func.count(TelemetryPacket.id))
        .where(TelemetryPacket.contact_id == contact_id)
        .group_by(TelemetryPacket.packet)
    )
    return {name: int(number) for name, number in session.execute(query)}

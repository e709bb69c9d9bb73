"""Read all rows of a time range in blocks, for exports larger than memory."""

from __future__ import annotations

from collections.abc import Iterator
from datetime import datetime
from typing import Any

from sqlalchemy import Select, or_, select
from sqlalchemy.orm import InstrumentedAttribute

from gss.store.engine import Database
from gss.store.models import Command, Event, Frame, Solution, TelemetryPacket

BLOCK_ROWS = 4000
SOLUTION_ROWS = 500
"""Block size of solutions, smaller because they include overlay data."""


def packet_names(database: Database) -> list[str]:
    """Return the names of the stored packets, with one index lookup per name."""
    names: list[str] = []
    while True:
        query = select(TelemetryPacket.packet).where(TelemetryPacket.packet > (names[-1] if names else ""))
        with database.unit_of_work() as session:
            next_name = session.scalar(query.order_by(TelemetryPacket.packet).limit(1))
        if next_name is None:
            return names
        names.append(next_name)


def telemetry(database: Database, packet: str, start: datetime, end: datetime) -> Iterator[list[Any]]:
    """Yield blocks of (received, id, contact_id, device_time_s, request_id, values) of a packet."""
    row = TelemetryPacket
    query = select(row.received, row.id, row.contact_id, row.device_time_s, row.request_id, row.values)
    return _blocks(database, query.where(row.packet == packet), row.received, row.id, start, end, BLOCK_ROWS)


def solutions(database: Database, start: datetime, end: datetime) -> Iterator[list[Any]]:
    """Yield blocks of (created, id, Frame, Solution)."""
    query = select(Solution.created, Solution.id, Frame, Solution).join(Frame, Frame.id == Solution.frame_id)
    return _blocks(database, query, Solution.created, Solution.id, start, end, SOLUTION_ROWS)


def commands(database: Database, start: datetime, end: datetime) -> Iterator[list[Any]]:
    """Yield blocks of (created, id, Command)."""
    query = select(Command.created, Command.id, Command)
    return _blocks(database, query, Command.created, Command.id, start, end, BLOCK_ROWS)


def events(database: Database, start: datetime, end: datetime) -> Iterator[list[Any]]:
    """Yield blocks of (at, seq, Event)."""
    return _blocks(database, select(Event.at, Event.seq, Event), Event.at, Event.seq, start, end, BLOCK_ROWS)


def _blocks(
    database: Database,
    query: Select[*tuple[Any, ...]],
    time_column: InstrumentedAttribute[datetime],
    key: InstrumentedAttribute[int],
    start: datetime,
    end: datetime,
    block: int,
) -> Iterator[list[Any]]:
    """Yield blocks of rows from ``start`` (inclusive) to ``end`` (exclusive). No transaction stays open between
    blocks."""
    at, last = start, -1
    while True:
        later = or_(time_column > at, (time_column == at) & (key > last))
        page = query.where(time_column >= at, time_column < end, later).order_by(time_column, key).limit(block)
        with database.unit_of_work() as session:
            rows = list(session.execute(page))
        if rows:
            yield rows
        if len(rows) < block:
            return
        at, last = rows[-1][0], rows[-1][1]

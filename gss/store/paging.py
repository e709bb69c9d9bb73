"""Read a long table in pages. ``number``: constant column that orders the rows."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TypeVar

from sqlalchemy import Select
from sqlalchemy.orm import InstrumentedAttribute, Session

from gss.store.engine import Database

Row = TypeVar("Row")
BATCH = 500


def newest(
    session: Session, query: Select[Row], number: InstrumentedAttribute[int], limit: int, before: int | None
) -> list[Row]:
    """Return the latest rows with numbers below ``before``, newest first."""
    query = query.order_by(number.desc()).limit(limit)
    return list(session.scalars(query if before is None else query.where(number < before)))


def iterate_all(database: Database, query: Select[Row], number: InstrumentedAttribute[int]) -> Iterator[Row]:
    """Yield all rows, oldest first, read in batches. No transaction stays open between batches, because the reader can be
    slow."""
    last_number = 0
    while True:
        with database.unit_of_work() as session:
            rows = list(session.scalars(query.where(number > last_number).order_by(number).limit(BATCH)))
        if not rows:
            return
        yield from rows
        last_number = getattr(rows[-1], number.key)

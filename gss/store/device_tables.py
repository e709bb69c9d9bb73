"""Tables created for the device or read back from it."""

from __future__ import annotations

from sqlalchemy import select
from sqlalchemy.orm import Session

from gss.domain.errors import NotFound
from gss.store.models import DeviceTable


def add(session: Session, table: DeviceTable) -> DeviceTable:
    """Store a table's row and assign its id."""
    session.add(table)
    session.flush()
    return table


def get(session: Session, table_id: int) -> DeviceTable:
    """Return the table with that id. Raises NotFound if it does not exist."""
    row = session.get(DeviceTable, table_id)
    if row is None:
        raise NotFound("no such table", got=str(table_id))
    return row


def by_sha256(session: Session, kind: str, sha256: str) -> DeviceTable | None:
    """Return the latest table of that kind with that content."""
    query = select(DeviceTable).where(DeviceTable.kind == kind, DeviceTable.sha256 == sha256)
    return session.scalar(query.order_by(DeviceTable.id.desc()).limit(1))


def newest(session: Session, limit: int, kind: str = "") -> list[DeviceTable]:
    """Return the latest tables, newest first."""
    query = select(DeviceTable).where(DeviceTable.kind == kind) if kind else select(DeviceTable)
    return list(session.scalars(query.order_by(DeviceTable.id.desc()).limit(limit)))

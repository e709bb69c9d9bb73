"""Audit log. Rows are added and read, never changed."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import Select, func, select, text
from sqlalchemy.exc import IntegrityError
from sqlalchemy.orm import Session

from gss.store import paging
from gss.store.engine import Database
from gss.store.models import AuditRow

GUARDS = {
    "sqlite": ("audit_no_update", "audit_no_delete", "audit_no_replace"),
    "postgresql": ("audit_no_change", "audit_no_truncate"),
}
"""Triggers that prevent changes to the audit log, created by migration 0004."""
SQLITE_TRIGGERS = {
    "audit_no_update": "CREATE TRIGGER audit_no_update BEFORE UPDATE ON audit "
    "BEGIN SELECT RAISE(ABORT, 'the audit record is append-only'); END",
    "audit_no_delete": "CREATE TRIGGER audit_no_delete BEFORE DELETE ON audit "
    "BEGIN SELECT RAISE(ABORT, 'the audit record is append-only'); END",
    "audit_no_replace": "CREATE TRIGGER audit_no_replace BEFORE INSERT ON audit "
    "WHEN EXISTS (SELECT 1 FROM audit WHERE seq = NEW.seq OR previous = NEW.previous) "
    "BEGIN SELECT RAISE(ABORT, 'the audit record is append-only'); END",
}
"""Text of the triggers that migration 0004 creates. A trigger with another text is reported as missing."""
POSTGRES_ACTIVE_TRIGGERS = (
    "SELECT tgname FROM pg_trigger JOIN pg_proc ON pg_proc.oid = tgfoid WHERE tgrelid = 'audit'::regclass"
    " AND tgenabled IN ('O', 'A') AND tgqual IS NULL"
    " AND trim(prosrc) = 'BEGIN RAISE EXCEPTION ''the audit record is append-only''; END'"
)


@dataclass(frozen=True)
class AuditFilter:
    """Filter for audit rows by user, action prefix and result; "" matches all. ``since`` is inclusive, ``until``
    exclusive."""

    who: str = ""
    action: str = ""
    result: str = ""
    since: datetime | None = None
    until: datetime | None = None

    def apply(self, query: Select[Any]) -> Select[Any]:
        """Return the query with the filter's conditions."""
        if self.who:
            query = query.where(AuditRow.who == self.who)
        if self.action:
            query = query.where(AuditRow.action.startswith(self.action, autoescape=True))
        if self.result:
            query = query.where(AuditRow.result == self.result)
        if self.since:
            query = query.where(AuditRow.at >= self.since)
        if self.until:
            query = query.where(AuditRow.at < self.until)
        return query


def last(session: Session) -> AuditRow | None:
    """Return the newest row."""
    return session.scalar(select(AuditRow).order_by(AuditRow.seq.desc()).limit(1))


class PositionTaken(Exception):
    """Raised when another row was stored concurrently at the same position of the hash chain. The new row is not
    stored."""


def add(session: Session, row: AuditRow) -> None:
    """Append a row. Raises PositionTaken if its position in the hash chain is occupied."""
    session.add(row)
    try:
        session.flush()
    except IntegrityError as error:
        raise PositionTaken from error


def page(session: Session, filters: AuditFilter, limit: int, before: int | None = None) -> list[AuditRow]:
    """Return a page of matching rows, newest first, with numbers below ``before``."""
    return paging.newest(session, filters.apply(select(AuditRow)), AuditRow.seq, limit, before)


def iterate_all(database: Database, filters: AuditFilter) -> Iterator[AuditRow]:
    """Yield all matching rows, oldest first, read in batches."""
    return paging.iterate_all(database, filters.apply(select(AuditRow)), AuditRow.seq)


def hashes(session: Session, numbers: Iterable[int]) -> dict[int, str]:
    """Return the stored hashes of the rows with these numbers; missing rows are omitted."""
    query = select(AuditRow.seq, AuditRow.hash).where(AuditRow.seq.in_(list(numbers)))
    return {row.seq: row.hash for row in session.execute(query)}


def count_before_start(session: Session) -> int:
    """Return the number of rows inserted before the start of the chain."""
    return session.scalar(select(func.count()).select_from(AuditRow).where(AuditRow.seq < 1)) or 0


def missing_guards(session: Session) -> list[str]:
    """Return the protective triggers that are missing, disabled or ineffective."""
    kind = session.get_bind().dialect.name
    if kind == "sqlite":
        rows = session.execute(text("SELECT name, sql FROM sqlite_master WHERE type = 'trigger'")).all()
        intact = {name for name, sql in rows if SQLITE_TRIGGERS.get(name) == sql}
    else:
        intact = set(session.scalars(text(POSTGRES_ACTIVE_TRIGGERS)))
    return [name for name in GUARDS[kind] if name not in intact]

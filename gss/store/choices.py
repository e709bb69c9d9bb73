"""Settings that operators change at run time, stored by name."""

from __future__ import annotations

from datetime import datetime

from sqlalchemy import select
from sqlalchemy.orm import Session

from gss.domain.json_object import JsonObject
from gss.store.models import Choice

TRUSTED_TIME = "upkeep.trusted-time"
AUDIT_ANCHOR = "audit.anchor"
"""Name of the choice that is stored when the audit log gets an anchor file."""


def trusted_time(session: Session) -> datetime | None:
    """Return the last time at which the server's clock was plausible; None if none is stored."""
    row = session.get(Choice, TRUSTED_TIME)
    return datetime.fromisoformat(row.value["at"]) if row else None


def has(session: Session, name: str) -> bool:
    """True if the choice is stored."""
    return session.get(Choice, name) is not None


def read(session: Session, prefix: str) -> list[Choice]:
    """Return all choices whose name starts with ``prefix``, sorted by name."""
    return list(
        session.scalars(select(Choice).where(Choice.name.startswith(prefix, autoescape=True)).order_by(Choice.name))
    )


def write(session: Session, name: str, value: JsonObject, now: datetime, user: str) -> Choice:
    """Store a choice, replacing an earlier one."""
    return session.merge(Choice(name=name, value=value, changed=now, user=user))


def forget(session: Session, name: str) -> bool:
    """Delete a choice. Return False if it was not stored."""
    row = session.get(Choice, name)
    if row is None:
        return False
    session.delete(row)
    return True

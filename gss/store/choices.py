"""Settings that operators change at run time, by name."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from gss.store.models import Choice


def read(session: Session, prefix: str) -> list[Choice]:
    """Return all choices whose name starts with ``prefix``, by name."""
    return list(
        session.scalars(select(Choice).where(Choice.name.startswith(prefix, autoescape=True)).order_by(Choice.name))
    )


def write(session: Session, name: str, value: dict[str, Any], now: datetime, user: str) -> Choice:
    """Store a choice, replacing an earlier one."""
    return session.merge(Choice(name=name, value=value, changed=now, user=user))


def forget(session: Session, name: str) -> bool:
    """Delete a choice; False if there was none."""
    row = session.get(Choice, name)
    if row is None:
        return False
    session.delete(row)
    return True

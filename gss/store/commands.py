"""Commands and their stages."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from gss.domain.errors import NotFound
from gss.store.models import Command, CommandStage

OPEN_RESULTS = ("queued", "released", "sent", "accepted", "started", "progress")


def add(
    session: Session,
    now: datetime,
    *,
    contact_id: int | None,
    request_id: int,
    name: str,
    arguments: dict[str, Any],
    user: str,
    source: str,
) -> Command:
    """A command that has just been queued."""
    row = Command(
        contact_id=contact_id,
        request_id=request_id,
        name=name,
        arguments=arguments,
        user=user,
        source=source,
        created=now,
        result="queued",
        detail="",
        late=False,
        attempts=1,
        resolved_note="",
        values={},
    )
    row.stages = [CommandStage(stage="queued", at=now, detail="")]
    session.add(row)
    session.flush()
    return row


def get(session: Session, command_id: int) -> Command:
    """The command of that id."""
    row = session.get(Command, command_id)
    if row is None:
        raise NotFound("no such command", got=str(command_id))
    return row


def by_request(session: Session, request_id: int) -> Command | None:
    """The newest command that used that request id."""
    return session.scalar(select(Command).where(Command.request_id == request_id).order_by(Command.id.desc()).limit(1))


def newest(session: Session, limit: int, contact_id: int | None = None) -> list[Command]:
    """Newest commands first."""
    query = select(Command).order_by(Command.id.desc()).limit(limit)
    if contact_id is not None:
        query = query.where(Command.contact_id == contact_id)
    return list(session.scalars(query))


def last_request_id(session: Session) -> int:
    """Largest request id ever used; 0 before the first."""
    return session.scalar(select(func.max(Command.request_id))) or 0


def left_in_flight(session: Session) -> list[Command]:
    """Commands whose fate was open when the server stopped."""
    return list(session.scalars(select(Command).where(Command.result.in_(OPEN_RESULTS))))

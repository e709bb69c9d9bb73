"""Commands and their stages."""

from __future__ import annotations

import json
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from sqlalchemy import Select, String, cast, func, or_, select
from sqlalchemy.orm import Session

from gss.domain.errors import NotFound
from gss.domain.json_object import JsonObject
from gss.store import paging
from gss.store.engine import Database
from gss.store.models import Choice, Command, CommandStage, Contact, Device

USED_IDS = "request_ids.used"
MAX_ID = 0xFFFF_FFFE
OPEN_RESULTS = ("queued", "released", "sent", "accepted", "started", "progress")


@dataclass(frozen=True)
class Filter:
    """Filter for commands. ``start`` ≤ created < ``end``; ``text``: substring of name, arguments, detail, note or
    values. None, "" and () match all commands."""

    start: datetime | None = None
    end: datetime | None = None
    names: Sequence[str] = ()
    results: Sequence[str] = ()
    user: str = ""
    source: str = ""
    contact_id: int | None = None
    run_id: int | None = None
    text: str = ""

    def apply(self, query: Select[Any]) -> Select[Any]:
        """Return the query with the filter's conditions."""
        conditions: list[Any] = []
        if self.start is not None:
            conditions.append(Command.created >= self.start)
        if self.end is not None:
            conditions.append(Command.created < self.end)
        if self.names:
            conditions.append(Command.name.in_(self.names))
        if self.results:
            conditions.append(Command.result.in_(self.results))
        for column, value in (
            (Command.user, self.user or None),
            (Command.source, self.source or None),
            (Command.contact_id, self.contact_id),
            (Command.run_id, self.run_id),
        ):
            if value is not None:
                conditions.append(column == value)
        if self.text:
            stored = (cast(Command.arguments, String), cast(Command.values, String))
            columns = (Command.name, Command.detail, Command.resolved_note, *stored)
            escaped = json.dumps(self.text)[1:-1]  # JSON is stored with escaped characters
            searched = [(c, self.text) for c in columns] + [(c, escaped) for c in stored]
            conditions.append(or_(*(c.icontains(text, autoescape=True) for c, text in searched)))
        return query.where(*conditions)


def add(
    session: Session,
    now: datetime,
    *,
    contact_id: int | None,
    request_id: int,
    name: str,
    arguments: JsonObject,
    user: str,
    source: str,
    run_id: int | None = None,
    unit: str = "",
) -> Command:
    """Store a newly queued command."""
    row = Command(
        contact_id=contact_id,
        request_id=request_id,
        unit=unit,
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
        run_id=run_id,
    )
    row.stages = [CommandStage(stage="queued", at=now, detail="")]
    session.add(row)
    session.flush()
    return row


def get(session: Session, command_id: int) -> Command:
    """Return the command with that id. Raises NotFound if it does not exist."""
    row = session.get(Command, command_id)
    if row is None:
        raise NotFound("no such command", got=str(command_id))
    return row


def by_request(session: Session, request_id: int) -> Command | None:
    """Return the newest command that used that request id."""
    return session.scalar(select(Command).where(Command.request_id == request_id).order_by(Command.id.desc()).limit(1))


def page(session: Session, filters: Filter, limit: int, before: int | None = None) -> list[Command]:
    """Return a page of matching commands, newest first, with ids below ``before``."""
    return paging.newest(session, filters.apply(select(Command)), Command.id, limit, before)


def iterate_all(database: Database, filters: Filter) -> Iterator[Command]:
    """Yield all matching commands, oldest first, read in batches."""
    return paging.iterate_all(database, filters.apply(select(Command)), Command.id)


def facets(session: Session) -> dict[str, list[str]]:
    """Return the sorted names, users, results and sources that occur in the history."""
    columns = {"names": Command.name, "users": Command.user, "results": Command.result, "sources": Command.source}
    return {key: sorted(session.scalars(select(column).distinct())) for key, column in columns.items()}


def of_unknown_fate(session: Session, limit: int) -> list[Command]:
    """Return commands with an unknown result, newest first."""
    return page(session, Filter(results=("unknown",)), limit)


def unit_of_contact(session: Session, row: Command) -> str | None:
    """Return the name of the last unit that answered in the contact of a command, for ABORT and rows of earlier versions, which
    have no unit. None if no unit answered."""
    query = select(Device.name).join(Contact, Contact.device_id == Device.id).where(Contact.id == row.contact_id)
    return session.scalar(query)


def last_request_id(session: Session) -> int:
    """Return the largest request id that can have been used; 0 if none."""
    skipped = session.get(Choice, USED_IDS)
    used = session.scalar(select(func.max(Command.request_id))) or 0
    return max(used, int(skipped.value["upto"]) if skipped else 0)


def skip_request_ids(session: Session, number: int, now: datetime) -> None:
    """Mark the next ``number`` request ids as used. A restored database does not contain the ids used after the backup,
    and the device would answer a repeated id with the old result."""
    upto = min(last_request_id(session) + number, MAX_ID)
    session.merge(Choice(name=USED_IDS, value={"upto": upto}, changed=now, user="gss restore"))


def left_in_flight(session: Session) -> list[Command]:
    """Return commands without a final result when the server stopped."""
    return list(session.scalars(select(Command).where(Command.result.in_(OPEN_RESULTS))))

"""Checklists of contacts and hand-over notes."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

from sqlalchemy import false, func, insert, literal, select, update
from sqlalchemy.orm import Session

from gss.domain.errors import NotFound
from gss.store.models import ChecklistMark, ChecklistVersion, Contact, HandoverNote


def add(session: Session, row: ChecklistVersion | HandoverNote) -> None:
    """Store a new row and assign its id."""
    session.add(row)
    session.flush()


def checklist_of(session: Session, contact_id: int) -> ChecklistVersion | None:
    """Return the version of the list for a contact, None for contacts before the first version."""
    query = select(ChecklistVersion).where(ChecklistVersion.first_contact_id <= contact_id)
    return session.scalar(query.order_by(ChecklistVersion.id.desc()).limit(1))


def add_checklist(
    session: Session, newest: ChecklistVersion | None, items: Sequence[str], user: str, now: datetime
) -> ChecklistVersion:
    """Store the version after ``newest``, valid for the open contact and later ones. Raises Conflict if another user has
    changed the list at the same time."""
    opened = session.scalar(select(func.min(Contact.id)).where(Contact.ended.is_(None)))
    first = opened or (session.scalar(select(func.max(Contact.id))) or 0) + 1
    # The id is given, so that the database rejects the second of two changes.
    version = newest.id + 1 if newest else 1
    row = ChecklistVersion(id=version, items=list(items), user=user, changed=now, first_contact_id=first)
    add(session, row)
    return row


def newest_checklist(session: Session) -> ChecklistVersion | None:
    """Return the newest version of the list."""
    return session.scalar(select(ChecklistVersion).order_by(ChecklistVersion.id.desc()).limit(1))


def marks(session: Session, contact_id: int) -> list[ChecklistMark]:
    """Return the changes of a contact's items, oldest first."""
    query = select(ChecklistMark).where(ChecklistMark.contact_id == contact_id)
    return list(session.scalars(query.order_by(ChecklistMark.id)))


def mark(session: Session, contact_id: int, item: str, done: bool, user: str, at: datetime) -> None:
    """Store the change of an item. Stores nothing if the item already has this state, so that the first of several equal
    changes keeps its user and time."""
    session.get(Contact, contact_id, with_for_update=True)  # PostgreSQL: one change after the other
    newest = select(ChecklistMark.done).where(ChecklistMark.contact_id == contact_id, ChecklistMark.item == item)
    state = func.coalesce(newest.order_by(ChecklistMark.id.desc()).limit(1).scalar_subquery(), false())
    columns = {"contact_id": contact_id, "item": item, "done": done, "user": user, "at": at}
    values = [literal(value, ChecklistMark.__table__.c[name].type) for name, value in columns.items()]
    session.execute(insert(ChecklistMark).from_select(list(columns), select(*values).where(state != literal(done))))


def notes(session: Session, contact_id: int) -> list[HandoverNote]:
    """Return the hand-over notes of a contact, oldest first."""
    query = select(HandoverNote).where(HandoverNote.contact_id == contact_id)
    return list(session.scalars(query.order_by(HandoverNote.id)))


def unacknowledged_notes(session: Session, user: str, limit: int) -> list[HandoverNote]:
    """Return the newest ``limit`` hand-over notes of other users than ``user`` that are not acknowledged, oldest first."""
    query = select(HandoverNote).where(HandoverNote.acknowledged_by == "", HandoverNote.user != user)
    return list(session.scalars(query.order_by(HandoverNote.id.desc()).limit(limit)))[::-1]


def acknowledge(session: Session, note_id: int, user: str, at: datetime) -> bool:
    """Record who acknowledged a note. Returns False if another user did so before."""
    change = update(HandoverNote).where(HandoverNote.id == note_id, HandoverNote.acknowledged_by == "")
    change = change.values(acknowledged_by=user, acknowledged=at).returning(HandoverNote.id)
    # Without synchronisation, the loaded row would show this user even if the database has stored another one.
    acknowledged = session.scalars(change, execution_options={"synchronize_session": False})
    return acknowledged.one_or_none() is not None


def note(session: Session, note_id: int) -> HandoverNote:
    """Return the hand-over note with that id, locked until the end of the transaction if the database supports it.
    Raises NotFound."""
    row = session.get(HandoverNote, note_id, with_for_update=True)
    if row is None:
        raise NotFound("There is no such hand-over note", got=str(note_id))
    return row

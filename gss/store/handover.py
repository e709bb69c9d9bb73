"""Checklists of contacts and hand-over notes."""

from __future__ import annotations

from datetime import datetime

from sqlalchemy import select, update
from sqlalchemy.orm import Session

from gss.domain.errors import NotFound
from gss.store.models import ChecklistMark, ChecklistVersion, HandoverNote


def add(session: Session, row: ChecklistVersion | ChecklistMark | HandoverNote) -> None:
    """Store a new row and assign its id."""
    session.add(row)
    session.flush()


def checklist_at(session: Session, at: datetime) -> ChecklistVersion | None:
    """Return the version of the list that was valid at a time, None if no version was stored until then."""
    query = select(ChecklistVersion).where(ChecklistVersion.changed <= at)
    return session.scalar(query.order_by(ChecklistVersion.id.desc()).limit(1))


def newest_checklist(session: Session) -> ChecklistVersion | None:
    """Return the newest version of the list."""
    return session.scalar(select(ChecklistVersion).order_by(ChecklistVersion.id.desc()).limit(1))


def marks(session: Session, contact_id: int) -> list[ChecklistMark]:
    """Return the changes of a contact's items, oldest first."""
    query = select(ChecklistMark).where(ChecklistMark.contact_id == contact_id)
    return list(session.scalars(query.order_by(ChecklistMark.id)))


def notes(session: Session, contact_id: int) -> list[HandoverNote]:
    """Return the hand-over notes of a contact, oldest first."""
    query = select(HandoverNote).where(HandoverNote.contact_id == contact_id)
    return list(session.scalars(query.order_by(HandoverNote.id)))


def unacknowledged_notes(session: Session, user: str, limit: int) -> list[HandoverNote]:
    """Return the hand-over notes of other users than ``user`` that are not acknowledged, oldest first."""
    query = select(HandoverNote).where(HandoverNote.acknowledged_by == "", HandoverNote.user != user)
    return list(session.scalars(query.order_by(HandoverNote.id).limit(limit)))


def acknowledge(session: Session, note_id: int, user: str, at: datetime) -> bool:
    """Record who acknowledged a note. Returns False if another user did so before."""
    change = update(HandoverNote).where(HandoverNote.id == note_id, HandoverNote.acknowledged_by == "")
    acknowledged = session.scalars(change.values(acknowledged_by=user, acknowledged=at).returning(HandoverNote.id))
    return acknowledged.one_or_none() is not None


def note(session: Session, note_id: int) -> HandoverNote:
    """Return the hand-over note with that id, locked until the end of the transaction if the database supports it.
    Raises NotFound."""
    row = session.get(HandoverNote, note_id, with_for_update=True)
    if row is None:
        raise NotFound("There is no such hand-over note", got=str(note_id))
    return row

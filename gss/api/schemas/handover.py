"""Checklists of contacts and hand-over notes."""

from __future__ import annotations

from pydantic import Field

from gss.api.schemas.base import In, Out, Utc
from gss.operations.contacts.handover import MAX_NOTE_LENGTH, CheckedItem, Checklist
from gss.store.models.handover import MAX_ITEM_LENGTH


class HandoverNoteOut(Out):
    """Note from an operator to the next one. ``acknowledged_by``: "" until another user has acknowledged it."""

    id: int
    contact_id: int
    text: str
    user: str
    at: Utc
    acknowledged_by: str
    acknowledged: Utc | None


class HandoverOut(Out):
    """Checklist and hand-over notes of a contact, notes oldest first."""

    contact_id: int
    checklist: Checklist
    items: list[CheckedItem]
    notes: list[HandoverNoteOut]


class CheckIn(In):
    """Item of a contact's checklist, and whether it is done."""

    item: str = Field(min_length=1, max_length=MAX_ITEM_LENGTH)
    done: bool


class HandoverNoteIn(In):
    """Note to the next operator."""

    text: str = Field(min_length=1, max_length=MAX_NOTE_LENGTH)

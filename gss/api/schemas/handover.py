"""Checklists of contacts and hand-over notes."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from gss.api.schemas.base import In, Out, Utc
from gss.operations.contacts.handover import MAX_ITEM_LENGTH, MAX_NOTE_LENGTH


class ChecklistOut(Out):
    """Items to check in each contact. ``source``: changed by a user, from the instrument package, or the default.
    ``version``: 0 if users have not changed the list; ``user`` and ``changed``: last change."""

    items: list[str]
    source: Literal["user", "instrument", "default"]
    version: int
    user: str
    changed: Utc | None


class CheckedItemOut(Out):
    """Item of a contact's checklist. ``user`` and ``at``: last change; "" and null if it was never checked. ``unchecked``:
    user whose check was removed, "" if the item is done or was never checked."""

    text: str
    done: bool
    user: str
    at: Utc | None
    unchecked: str


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
    checklist: ChecklistOut
    items: list[CheckedItemOut]
    notes: list[HandoverNoteOut]


class CheckIn(In):
    """Item of a contact's checklist, and whether it is done."""

    item: str = Field(min_length=1, max_length=MAX_ITEM_LENGTH)
    done: bool


class HandoverNoteIn(In):
    """Note to the next operator."""

    text: str = Field(min_length=1, max_length=MAX_NOTE_LENGTH)

"""Checklist of each contact, and notes from one operator to the next."""

from __future__ import annotations

import logging
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Annotated, Literal
from unicodedata import normalize

from pydantic import Field

from gss.domain.errors import BadInput, Conflict, StoreDown
from gss.operations.clock import Now
from gss.operations.events import EventBus
from gss.operations.requests import MAX_ID, Request
from gss.store import devices
from gss.store import handover as store
from gss.store.engine import Database
from gss.store.models import ChecklistMark, ChecklistVersion, HandoverNote
from gss.store.models.handover import MAX_ITEM_LENGTH

log = logging.getLogger("gss.contacts")

MAX_ITEMS, MAX_NOTE_LENGTH, MAX_NOTES = 40, 4000, 50
DEFAULT_ITEMS = (
    "Link up, device and dictionary match",
    "Housekeeping received, alarms acknowledged",
    "Device clock compared, and set if necessary",
    "Active bank and its days left checked",
    "Planned commands completed, unknown results resolved",
    "Frames downlinked, no transfer open",
    "Hand-over note written",
)
"""Items of an instrument whose package lists none."""

ListSource = Literal["user", "instrument", "default"]


class ChecklistRequest(Request):
    """New list of items. ``version``: the version that was changed."""

    items: list[Annotated[str, Field(min_length=1, max_length=MAX_ITEM_LENGTH)]] = Field(max_length=MAX_ITEMS)
    version: int = Field(ge=0, le=MAX_ID)


@dataclass(frozen=True)
class Checklist:
    """Items to check in each contact. ``version``: id of its stored version, 0 if none is stored; ``user`` and ``changed``:
    last change by a user, "" and None if users have not changed it."""

    items: tuple[str, ...]
    source: ListSource
    version: int
    user: str
    changed: datetime | None


@dataclass(frozen=True)
class CheckedItem:
    """Item of a contact's checklist. ``user`` and ``at``: last change; "" and None if it was never checked. ``unchecked``:
    user whose check was removed, "" if the item is done or was never checked."""

    text: str
    done: bool
    user: str
    at: datetime | None
    unchecked: str


@dataclass(frozen=True)
class Handover:
    """Checklist and hand-over notes of a contact, notes oldest first."""

    contact_id: int
    checklist: Checklist
    items: list[CheckedItem]
    notes: list[HandoverNote]


class HandoverService:
    """Stores checklists and hand-over notes. ``package_items``: items in the package of the unit's instrument."""

    def __init__(self, database: Database, bus: EventBus, now: Now, package_items: Sequence[str]) -> None:
        self._database, self._bus, self._now = database, bus, now
        package = tuple(dict.fromkeys(filter(None, map(one_line, package_items))))
        source: ListSource = "instrument" if package else "default"
        self._shipped = Checklist(package or DEFAULT_ITEMS, source, version=0, user="", changed=None)
        self._is_shipped_stored = False

    def start(self) -> None:
        """Store the list of the package as a version, unless users have changed the list, so that each contact keeps
        its items when a later package has others. If the store is down, the next reader of a list stores it."""
        try:
            self._store_shipped()
        except StoreDown as error:
            log.warning("the checklist of the package was not stored: %s", error)

    def _store_shipped(self) -> None:
        if self._is_shipped_stored:
            return
        with self._database.unit_of_work() as session:
            newest = store.newest_checklist(session)
            if newest is None or (not newest.user and tuple(newest.items) != self._shipped.items):
                store.add_checklist(session, newest, self._shipped.items, "", self._now())
        self._is_shipped_stored = True

    def checklist(self) -> Checklist:
        """Return the newest list."""
        self._store_shipped()
        with self._database.unit_of_work() as session:
            return self._list_of(store.newest_checklist(session))

    def change_checklist(self, request: ChecklistRequest, *, user: str) -> Checklist:
        """Store a new list. It applies to open and later contacts; closed contacts keep their list. Raises BadInput for
        an empty or repeated item, Conflict if another user has changed the list since."""
        items = [one_line(item) for item in request.items]
        if not all(map(_is_visible, items)) or len({normalize("NFC", item) for item in items}) < len(items):
            raise BadInput(
                "An item of the checklist is empty or repeated",
                expected="different texts",
                hint="Remove empty lines and repeated items.",
            )
        with self._database.unit_of_work() as session:
            newest = store.newest_checklist(session)
            version = newest.id if newest else 0
            if version != request.version:
                raise Conflict(
                    "The checklist has changed since you opened it",
                    expected=f"version {version}",
                    got=f"version {request.version}",
                    hint="Open the latest version and change it.",
                )
            row = store.add_checklist(session, newest, items, user, self._now())
        return self._list_of(row)

    def of_contact(self, contact_id: int) -> Handover:
        """Return checklist and notes of a contact. Raises NotFound."""
        self._store_shipped()
        with self._database.unit_of_work() as session:
            devices.get_contact(session, contact_id)
            version = store.checklist_of(session, contact_id)
            marks, notes = store.marks(session, contact_id), store.notes(session, contact_id)
        checklist, of_item = self._list_of(version), dict[str, list[ChecklistMark]]()
        for mark in marks:
            of_item.setdefault(mark.item, []).append(mark)
        # Of a contact before the first stored version, only the checked items are known.
        listed = () if version is None else checklist.items
        removed = [item for item in of_item if item not in listed]
        items = [_checked(text, of_item.get(text, ())) for text in (*listed, *removed)]
        return Handover(contact_id, checklist, items, notes)

    def check(self, contact_id: int, item: str, *, done: bool, user: str) -> CheckedItem:
        """Mark an item of a contact as done or not done, and return its state. An unchanged state keeps its user and time.
        Raises NotFound, BadInput for an item that the contact's list does not contain."""
        if not any(known.text == item for known in self.of_contact(contact_id).items):
            raise BadInput(
                "The checklist of this contact has no such item", got=item[:80], hint="Read the checklist again."
            )
        with self._database.unit_of_work() as session:
            store.mark(session, contact_id, item, done, user, self._now())
        with self._database.unit_of_work() as session:
            return _checked(item, [mark for mark in store.marks(session, contact_id) if mark.item == item])

    def add_note(self, contact_id: int, text: str, *, user: str) -> HandoverNote:
        """Store a note to the next operator. Raises NotFound, BadInput for an empty text."""
        if not _is_visible(text):
            raise BadInput("The hand-over note is empty", expected="a text")
        with self._database.unit_of_work() as session:
            devices.get_contact(session, contact_id)
            row = HandoverNote(contact_id=contact_id, text=text.strip(), user=user, at=self._now())
            store.add(session, row)
        self._bus.record("contact", "ok", f"{user} wrote a hand-over note", contact_id=contact_id)
        return row

    def unacknowledged_notes(self, user: str) -> list[HandoverNote]:
        """Return the newest MAX_NOTES hand-over notes of other users that are not acknowledged, oldest first."""
        with self._database.unit_of_work() as session:
            return store.unacknowledged_notes(session, user, MAX_NOTES)

    def acknowledge(self, note_id: int, *, user: str) -> HandoverNote:
        """Record that a user has read a note. Raises NotFound, Conflict for a user's own note or a note that is already
        acknowledged."""
        with self._database.unit_of_work() as session:
            row = store.note(session, note_id)
            if row.user == user:
                raise Conflict("You cannot acknowledge your own note", expected="another user", got=user)
            is_first = store.acknowledge(session, note_id, user, self._now())
            session.refresh(row)
            if not is_first:
                raise Conflict("The note is already acknowledged", got=f"by {row.acknowledged_by}")
        return row

    def _list_of(self, row: ChecklistVersion | None) -> Checklist:
        if row is None:
            return self._shipped
        items = tuple(row.items)
        if row.user:
            return Checklist(items, "user", row.id, row.user, row.changed)
        return Checklist(items, "default" if items == DEFAULT_ITEMS else "instrument", row.id, user="", changed=None)


def _is_visible(text: str) -> bool:
    """True if a text has a visible character. False, for example, for spaces of zero width."""
    return any(c.isprintable() and not c.isspace() for c in text)


def one_line(text: str) -> str:
    """Return the text without line breaks, repeated spaces, and spaces at its ends."""
    return " ".join(text.split())


def _checked(text: str, marks: Sequence[ChecklistMark]) -> CheckedItem:
    """Return the state of an item from its changes, oldest first."""
    if not marks:
        return CheckedItem(text, False, "", None, "")
    newest = marks[-1]
    checks = [mark.user for mark in marks if mark.done]
    return CheckedItem(text, newest.done, newest.user, newest.at, checks[-1] if checks and not newest.done else "")

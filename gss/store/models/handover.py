"""Checklists of contacts and hand-over notes."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from sqlalchemy import ForeignKey, String, Text
from sqlalchemy.orm import Mapped, mapped_column

from gss.store.models.base import Base

MAX_ITEM_LENGTH = 200


class ChecklistVersion(Base):
    """Version of the list of items for contacts. ``items``: texts in order. ``user``: "" for the list of the instrument
    package or the default. ``first_contact_id``: first contact with this list; it is an id and not a time, because the clock
    can be set."""

    __tablename__ = "checklist_versions"
    id: Mapped[int] = mapped_column(primary_key=True)
    items: Mapped[list[Any]]
    user: Mapped[str] = mapped_column(String(60))
    changed: Mapped[datetime]
    first_contact_id: Mapped[int]


class ChecklistMark(Base):
    """Change of an item of a contact's checklist. The newest row of an item is its state."""

    __tablename__ = "checklist_marks"
    id: Mapped[int] = mapped_column(primary_key=True)
    contact_id: Mapped[int] = mapped_column(ForeignKey("contacts.id"), index=True)
    item: Mapped[str] = mapped_column(String(MAX_ITEM_LENGTH))
    done: Mapped[bool]
    user: Mapped[str] = mapped_column(String(60))
    at: Mapped[datetime]


class HandoverNote(Base):
    """Note of an operator to the next one. ``acknowledged_by``: "" until another user has acknowledged it."""

    __tablename__ = "handover_notes"
    id: Mapped[int] = mapped_column(primary_key=True)
    contact_id: Mapped[int] = mapped_column(ForeignKey("contacts.id"), index=True)
    text: Mapped[str] = mapped_column(Text)
    user: Mapped[str] = mapped_column(String(60))
    at: Mapped[datetime]
    acknowledged_by: Mapped[str] = mapped_column(String(60), default="")
    acknowledged: Mapped[datetime | None]

"""Automation: derived parameters, procedures and notifications."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from sqlalchemy import ForeignKey, String, Text
from sqlalchemy.orm import Mapped, mapped_column

from gss.domain.json_object import JsonObject
from gss.store.models.base import Base


class DerivedParameter(Base):
    """Definition of a derived parameter. ``limits``: [low, high] of each level, null for none."""

    __tablename__ = "derived_parameters"
    id: Mapped[int] = mapped_column(primary_key=True)
    name: Mapped[str] = mapped_column(String(30), unique=True)
    title: Mapped[str] = mapped_column(String(80), default="")
    expression: Mapped[str] = mapped_column(Text)
    unit: Mapped[str] = mapped_column(String(20), default="")
    decimals: Mapped[int]
    limits: Mapped[JsonObject]
    persistence: Mapped[int]
    author: Mapped[str] = mapped_column(String(60))
    changed: Mapped[datetime]


class Procedure(Base):
    """Procedure as Markdown text. The id of a deleted procedure is not used again."""

    __tablename__ = "procedures"
    id: Mapped[int] = mapped_column(primary_key=True)
    name: Mapped[str] = mapped_column(String(80), unique=True)
    text: Mapped[str] = mapped_column(Text)
    author: Mapped[str] = mapped_column(String(60))
    changed: Mapped[datetime]
    __table_args__ = ({"sqlite_autoincrement": True},)


class ProcedureRun(Base):
    """Run of a procedure: a copy of its text, and one entry per started step. ``current``: name of the next step or the
    step in progress, "" at the end. ``sha256``: hash of the record, set when the record is frozen at the end."""

    __tablename__ = "procedure_runs"
    id: Mapped[int] = mapped_column(primary_key=True)
    procedure_id: Mapped[int | None] = mapped_column(ForeignKey("procedures.id", ondelete="SET NULL"))
    name: Mapped[str] = mapped_column(String(80))
    text: Mapped[str] = mapped_column(Text)
    instrument: Mapped[str] = mapped_column(String(40))
    contact_id: Mapped[int | None] = mapped_column(ForeignKey("contacts.id"), index=True)
    user: Mapped[str] = mapped_column(String(60))
    automatic: Mapped[bool]
    state: Mapped[str] = mapped_column(String(10), index=True)
    current: Mapped[str] = mapped_column(String(40))
    entries: Mapped[list[Any]]
    reason: Mapped[str] = mapped_column(Text, default="")
    started: Mapped[datetime]
    finished: Mapped[datetime | None]
    sha256: Mapped[str] = mapped_column(String(64), default="")


class Notification(Base):
    """Message about an alarm or event to one target. ``key``: unique key, so that the message is created once. ``due``:
    earliest time of sending or retrying. ``state``: pending, sending, sent, failed, withdrawn, or unknown after the
    server ended while sending."""

    __tablename__ = "notifications"
    id: Mapped[int] = mapped_column(primary_key=True)
    key: Mapped[str] = mapped_column(String(200), unique=True)
    rule: Mapped[str] = mapped_column(String(40))
    target: Mapped[str] = mapped_column(String(40))
    level: Mapped[str] = mapped_column(String(10))
    text: Mapped[str] = mapped_column(Text)
    alarm_id: Mapped[int | None]
    created: Mapped[datetime]
    due: Mapped[datetime]
    state: Mapped[str] = mapped_column(String(10), index=True)
    tries: Mapped[int]
    problem: Mapped[str] = mapped_column(Text, default="")
    finished: Mapped[datetime | None]

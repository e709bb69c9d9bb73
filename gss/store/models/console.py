"""Alarms, choices, command authority and jobs."""

from __future__ import annotations

from datetime import datetime

from sqlalchemy import JSON, String, Text
from sqlalchemy.orm import Mapped, mapped_column

from gss.domain.json_object import JsonObject
from gss.store.models.base import Base


class Alarm(Base):
    """Limit violation, from its first sample until the value is within limits and an operator has acknowledged it.
    Never deleted."""

    __tablename__ = "alarms"
    id: Mapped[int] = mapped_column(primary_key=True)
    packet: Mapped[str] = mapped_column(String(40))
    field: Mapped[str] = mapped_column(String(60), index=True)
    state: Mapped[str] = mapped_column(String(10))
    worst: Mapped[str] = mapped_column(String(10))
    value: Mapped[float | None]
    limit_text: Mapped[str] = mapped_column(String(120), default="")
    limit_set: Mapped[str] = mapped_column(String(30), default="")
    raised: Mapped[datetime] = mapped_column(index=True)
    cleared: Mapped[datetime | None]
    acknowledged: Mapped[datetime | None]
    acknowledged_by: Mapped[str] = mapped_column(String(60), default="")
    shelved_until: Mapped[datetime | None]
    shelved_by: Mapped[str] = mapped_column(String(60), default="")
    note: Mapped[str] = mapped_column(Text, default="")
    closed: Mapped[datetime | None] = mapped_column(index=True)


class Choice(Base):
    """Setting changed by an operator, for example the active limit set or changed limits."""

    __tablename__ = "choices"
    name: Mapped[str] = mapped_column(String(60), primary_key=True)
    value: Mapped[JsonObject]
    changed: Mapped[datetime]
    user: Mapped[str] = mapped_column(String(60))


class Authority(Base):
    """Period in which one user held command authority. The row without ``ended``, if any, is the current holder.
    ``transfer``: empty, ``request`` (``transfer_user`` requests authority) or ``offer`` (the holder offers it to that
    user)."""

    __tablename__ = "authorities"
    id: Mapped[int] = mapped_column(primary_key=True)
    holder: Mapped[str] = mapped_column(String(60))
    taken: Mapped[datetime]
    ended: Mapped[datetime | None] = mapped_column(index=True)
    ended_by: Mapped[str] = mapped_column(String(60), default="")
    reason: Mapped[str] = mapped_column(Text, default="")
    transfer: Mapped[str] = mapped_column(String(10), default="")
    transfer_user: Mapped[str] = mapped_column(String(60), default="")
    transfer_note: Mapped[str] = mapped_column(Text, default="")
    transfer_at: Mapped[datetime | None] = mapped_column(default=None)


class Job(Base):
    """Background job. ``checkpoint``: state from which the job resumes after a crash; its format depends on the kind.
    ``attempts``: number of server crashes during the job since its last progress."""

    __tablename__ = "jobs"
    id: Mapped[int] = mapped_column(primary_key=True)
    kind: Mapped[str] = mapped_column(String(30))
    title: Mapped[str] = mapped_column(String(120))
    state: Mapped[str] = mapped_column(String(12))
    done: Mapped[int] = mapped_column(default=0)
    total: Mapped[int] = mapped_column(default=0)
    text: Mapped[str] = mapped_column(Text, default="")
    created: Mapped[datetime]
    finished: Mapped[datetime | None]
    request: Mapped[JsonObject] = mapped_column(default=dict)
    result: Mapped[JsonObject] = mapped_column(default=dict)
    checkpoint: Mapped[JsonObject | None] = mapped_column(JSON(none_as_null=True))
    attempts: Mapped[int] = mapped_column(default=0)

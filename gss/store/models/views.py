"""Shared views of the console and their versions."""

from __future__ import annotations

from datetime import datetime

from sqlalchemy import ForeignKey, String, Text, UniqueConstraint
from sqlalchemy.orm import Mapped, mapped_column

from gss.store.models.base import Base


class SharedView(Base):
    """Console page with its state, shared by all users. ``path``: address within the unit, with its query; ``open``:
    true if every user with the permission can change the view, not only its owner; ``version``: number of the newest
    version."""

    __tablename__ = "shared_views"
    id: Mapped[int] = mapped_column(primary_key=True)
    name: Mapped[str] = mapped_column(String(80), unique=True)
    path: Mapped[str] = mapped_column(Text)
    note: Mapped[str] = mapped_column(Text, default="")
    owner: Mapped[str] = mapped_column(String(60))
    open: Mapped[bool] = mapped_column(default=False)
    version: Mapped[int]
    user: Mapped[str] = mapped_column(String(60))
    changed: Mapped[datetime]


class SharedViewVersion(Base):
    """Stored version of a shared view."""

    __tablename__ = "shared_view_versions"
    __table_args__ = (UniqueConstraint("view_id", "version"),)
    id: Mapped[int] = mapped_column(primary_key=True)
    view_id: Mapped[int] = mapped_column(ForeignKey("shared_views.id", ondelete="CASCADE"))
    version: Mapped[int]
    name: Mapped[str] = mapped_column(String(80))
    path: Mapped[str] = mapped_column(Text)
    note: Mapped[str] = mapped_column(Text, default="")
    user: Mapped[str] = mapped_column(String(60))
    changed: Mapped[datetime]

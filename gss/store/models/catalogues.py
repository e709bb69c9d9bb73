"""What is made for the sensor."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from sqlalchemy import ForeignKey, String
from sqlalchemy.orm import Mapped, mapped_column

from gss.store.models.base import Base


class Catalogue(Base):
    """A built sub-catalogue: request, manifest, report; the image is a blob."""

    __tablename__ = "catalogues"
    id: Mapped[int] = mapped_column(primary_key=True)
    name: Mapped[str] = mapped_column(String(60))
    profile: Mapped[str] = mapped_column(String(40))
    format: Mapped[str] = mapped_column(String(20))
    created: Mapped[datetime]
    author: Mapped[str] = mapped_column(String(60))
    stars: Mapped[int]
    pairs: Mapped[int]
    size: Mapped[int]
    sha256: Mapped[str] = mapped_column(String(64), index=True)
    valid_from: Mapped[datetime | None]
    valid_to: Mapped[datetime | None]
    request: Mapped[dict[str, Any]]
    manifest: Mapped[dict[str, Any]]
    report: Mapped[dict[str, Any]]


class DeviceTable(Base):
    """Something for the sensor that is no catalogue: triplets, calibration, parameters. The bytes are a blob by hash."""

    __tablename__ = "device_tables"
    id: Mapped[int] = mapped_column(primary_key=True)
    kind: Mapped[str] = mapped_column(String(20))
    name: Mapped[str] = mapped_column(String(80))
    profile: Mapped[str] = mapped_column(String(40))
    format_version: Mapped[int]
    size: Mapped[int]
    sha256: Mapped[str] = mapped_column(String(64), index=True)
    created: Mapped[datetime]
    author: Mapped[str] = mapped_column(String(60))
    content: Mapped[dict[str, Any]] = mapped_column(default=dict)


class BankHistory(Base):
    """What was in a bank of a device, from when the device said so until it said otherwise."""

    __tablename__ = "bank_history"
    id: Mapped[int] = mapped_column(primary_key=True)
    device_id: Mapped[int] = mapped_column(ForeignKey("devices.id"), index=True)
    bank: Mapped[str] = mapped_column(String(20))
    state: Mapped[str] = mapped_column(String(20))
    sha256: Mapped[str] = mapped_column(String(64), default="")
    name: Mapped[str] = mapped_column(String(80), default="")
    catalogue_id: Mapped[int | None] = mapped_column(ForeignKey("catalogues.id"))
    began: Mapped[datetime] = mapped_column(index=True)
    ended: Mapped[datetime | None] = mapped_column(index=True)
    how: Mapped[str] = mapped_column(String(40), default="")
    user: Mapped[str] = mapped_column(String(60), default="")
    detail: Mapped[dict[str, Any]] = mapped_column(default=dict)


class StarSource(Base):
    """A star list that somebody brought: the bytes are a blob, ``report`` says what was read and what was dropped."""

    __tablename__ = "star_sources"
    id: Mapped[int] = mapped_column(primary_key=True)
    name: Mapped[str] = mapped_column(String(80))
    kind: Mapped[str] = mapped_column(String(20))
    created: Mapped[datetime]
    author: Mapped[str] = mapped_column(String(60))
    stars: Mapped[int]
    sha256: Mapped[str] = mapped_column(String(64))
    mapping: Mapped[dict[str, Any]]
    report: Mapped[dict[str, Any]]

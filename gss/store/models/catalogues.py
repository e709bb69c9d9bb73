"""Catalogues, device tables, bank history and star lists."""

from __future__ import annotations

from datetime import datetime

from sqlalchemy import ForeignKey, Index, String, Text
from sqlalchemy.orm import Mapped, mapped_column

from gss.domain.json_object import JsonObject
from gss.store.models.base import Base


class Catalogue(Base):
    """Built sub-catalogue: request, manifest and report; the image is a blob. ``profile`` and ``instrument_version``:
    name and version (SHA-256) of the instrument; the version is null if unknown."""

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
    request: Mapped[JsonObject]
    manifest: Mapped[JsonObject]
    report: Mapped[JsonObject]
    instrument_version: Mapped[str | None] = mapped_column(String(64))

    @property
    def validity_known(self) -> bool:
        """False for a catalogue that was read back from the device: its request and its period of validity are unknown."""
        return bool(self.request)


class DeviceTable(Base):
    """Device table other than a catalogue: triplets, calibration, parameters or bad pixels. The bytes are a blob with the key
    ``sha256``."""

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
    content: Mapped[JsonObject] = mapped_column(default=dict)


class BankHistory(Base):
    """Period in which a device bank had one state and content, starting with the device's first report. ``ended``: None
    if the content has not changed. ``reported``: time of the device's last report of this content."""

    __tablename__ = "bank_history"
    id: Mapped[int] = mapped_column(primary_key=True)
    device_id: Mapped[int | None] = mapped_column(ForeignKey("devices.id"))
    bank: Mapped[str] = mapped_column(String(12))
    state: Mapped[str] = mapped_column(String(12))
    sha256: Mapped[str] = mapped_column(String(64), default="")
    name: Mapped[str] = mapped_column(String(60), default="")
    catalogue_id: Mapped[int | None] = mapped_column(ForeignKey("catalogues.id"))
    began: Mapped[datetime] = mapped_column(index=True)
    reported: Mapped[datetime]
    ended: Mapped[datetime | None]
    how: Mapped[str] = mapped_column(String(20), default="")
    user: Mapped[str] = mapped_column(String(60), default="")
    note: Mapped[str] = mapped_column(Text, default="")
    __table_args__ = (Index("ix_bank_history_device_id_ended", "device_id", "ended"),)


class StarList(Base):
    """Imported star list. The original file is a blob; ``report`` lists the rows read and dropped."""

    __tablename__ = "star_lists"
    id: Mapped[int] = mapped_column(primary_key=True)
    name: Mapped[str] = mapped_column(String(80))
    created: Mapped[datetime]
    author: Mapped[str] = mapped_column(String(60))
    format: Mapped[str] = mapped_column(String(20))
    epoch_jyear: Mapped[float]
    frame: Mapped[str] = mapped_column(String(20))
    profile: Mapped[str] = mapped_column(String(40), default="")
    stars: Mapped[int]
    dropped: Mapped[int]
    size: Mapped[int]
    sha256: Mapped[str] = mapped_column(String(64), index=True)
    mapping: Mapped[JsonObject] = mapped_column(default=dict)
    report: Mapped[JsonObject] = mapped_column(default=dict)

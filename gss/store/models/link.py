"""Devices, contacts, commands, telemetry, transfers and events."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from sqlalchemy import BigInteger, ForeignKey, Index, String, Text
from sqlalchemy.orm import Mapped, mapped_column, relationship

from gss.domain.json_object import JsonObject
from gss.store.models.base import Base


class Device(Base):
    """Sensor that has identified itself at least once. ``simulated``: null if this is not known."""

    __tablename__ = "devices"
    id: Mapped[int] = mapped_column(primary_key=True)
    name: Mapped[str] = mapped_column(String(80), unique=True)
    profile: Mapped[str] = mapped_column(String(40))
    firmware: Mapped[str] = mapped_column(String(40))
    simulated: Mapped[bool | None]
    dictionary_hash: Mapped[str] = mapped_column(String(64))
    first_seen: Mapped[datetime]
    last_seen: Mapped[datetime]


class Contact(Base):
    """Contact, from the opening to the closing of the line. ``instrument``: name reported by the last device that
    responded; ``instrument_version``: SHA-256 of the package of this instrument; null: unknown."""

    __tablename__ = "contacts"
    id: Mapped[int] = mapped_column(primary_key=True)
    device_id: Mapped[int | None] = mapped_column(ForeignKey("devices.id"))
    url: Mapped[str] = mapped_column(String(300))
    started: Mapped[datetime]
    ended: Mapped[datetime | None]
    rx_bytes: Mapped[int] = mapped_column(default=0)
    tx_bytes: Mapped[int] = mapped_column(default=0)
    capture: Mapped[str] = mapped_column(String(300), default="")
    captures: Mapped[list[Any]] = mapped_column(default=list)
    note: Mapped[str] = mapped_column(Text, default="")
    instrument: Mapped[str | None] = mapped_column(String(40))
    instrument_version: Mapped[str | None] = mapped_column(String(64))


class Command(Base):
    """Command with its arguments and result. ``unit``: name of the unit for which it was queued, "" if not known."""

    __tablename__ = "commands"
    id: Mapped[int] = mapped_column(primary_key=True)
    contact_id: Mapped[int | None] = mapped_column(ForeignKey("contacts.id"), index=True)
    request_id: Mapped[int] = mapped_column(BigInteger, index=True)  # unsigned 32-bit on the wire
    unit: Mapped[str] = mapped_column(String(80), default="")
    name: Mapped[str] = mapped_column(String(60))
    arguments: Mapped[JsonObject]
    user: Mapped[str] = mapped_column(String(60))
    source: Mapped[str] = mapped_column(String(20))
    created: Mapped[datetime]
    finished: Mapped[datetime | None]
    result: Mapped[str] = mapped_column(String(20))
    detail: Mapped[str] = mapped_column(Text, default="")
    late: Mapped[bool] = mapped_column(default=False)
    attempts: Mapped[int] = mapped_column(default=1)
    resolved_note: Mapped[str] = mapped_column(Text, default="")
    values: Mapped[JsonObject] = mapped_column(default=dict)
    run_id: Mapped[int | None] = mapped_column(ForeignKey("procedure_runs.id"), index=True)
    stages: Mapped[list[CommandStage]] = relationship(
        order_by="CommandStage.id", lazy="selectin", cascade="all, delete-orphan"
    )


class CommandStage(Base):
    """One reported stage of a command."""

    __tablename__ = "command_stages"
    id: Mapped[int] = mapped_column(primary_key=True)
    command_id: Mapped[int] = mapped_column(ForeignKey("commands.id"), index=True)
    stage: Mapped[str] = mapped_column(String(20))
    at: Mapped[datetime]
    detail: Mapped[str] = mapped_column(Text, default="")


class TelemetryPacket(Base):
    """Decoded packet, with engineering values by field name. ``id`` always increases. ``device_time_s``: 0 if the device
    reports no time."""

    __tablename__ = "telemetry_packets"
    id: Mapped[int] = mapped_column(primary_key=True)
    contact_id: Mapped[int | None] = mapped_column(ForeignKey("contacts.id"))
    packet: Mapped[str] = mapped_column(String(40))
    received: Mapped[datetime]
    device_time_s: Mapped[float]
    request_id: Mapped[int] = mapped_column(BigInteger)
    values: Mapped[JsonObject]
    __table_args__ = (
        Index("ix_telemetry_packets_packet_received", "packet", "received"),
        {"sqlite_autoincrement": True},
    )


class TelemetryRollup(Base):
    """Extremes of a field in every ten seconds of one hour. ``hour``: hours since 1970; ``field`` empty: the row marks
    the hour as complete."""

    __tablename__ = "telemetry_rollups"
    packet: Mapped[str] = mapped_column(String(40), primary_key=True)
    field: Mapped[str] = mapped_column(String(60), primary_key=True)
    hour: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    data: Mapped[bytes]


class Transfer(Base):
    """Upload or download of a file."""

    __tablename__ = "transfers"
    id: Mapped[int] = mapped_column(primary_key=True)
    contact_id: Mapped[int | None] = mapped_column(ForeignKey("contacts.id"))
    direction: Mapped[str] = mapped_column(String(4))
    kind: Mapped[str] = mapped_column(String(20))
    target: Mapped[str] = mapped_column(String(20))
    subject: Mapped[str] = mapped_column(String(120))
    state: Mapped[str] = mapped_column(String(20))
    reason: Mapped[str] = mapped_column(Text, default="")
    size: Mapped[int] = mapped_column(default=0)
    chunk_size: Mapped[int] = mapped_column(default=0)
    stored: Mapped[list[Any]] = mapped_column(default=list)
    resent: Mapped[int] = mapped_column(default=0)
    sha256: Mapped[str] = mapped_column(String(64), default="")
    created: Mapped[datetime]
    finished: Mapped[datetime | None]
    frame_id: Mapped[int | None] = mapped_column(ForeignKey("frames.id"))
    catalogue_id: Mapped[int | None] = mapped_column(ForeignKey("catalogues.id"))
    table_id: Mapped[int | None] = mapped_column(ForeignKey("device_tables.id"))
    options: Mapped[JsonObject] = mapped_column(default=dict)
    log: Mapped[list[Any]] = mapped_column(default=list)


class Event(Base):
    """Recorded event. ``seq`` always increases."""

    __tablename__ = "events"
    seq: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    at: Mapped[datetime] = mapped_column(index=True)
    kind: Mapped[str] = mapped_column(String(30))
    severity: Mapped[str] = mapped_column(String(10))
    text: Mapped[str] = mapped_column(Text)
    data: Mapped[JsonObject] = mapped_column(default=dict)
    __table_args__ = ({"sqlite_autoincrement": True},)

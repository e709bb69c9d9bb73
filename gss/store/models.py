"""Tables. Times are UTC without zone in the database (SQLite has none) and with zone in Python."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any, ClassVar

from sqlalchemy import (
    JSON,
    BigInteger,
    DateTime,
    Dialect,
    ForeignKey,
    Index,
    LargeBinary,
    MetaData,
    String,
    Text,
    TypeDecorator,
)
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column, relationship


class UtcDateTime(TypeDecorator[datetime]):
    """A moment in UTC; refuses a datetime without a zone, so that local time cannot creep in."""

    impl = DateTime
    cache_ok = True

    def process_bind_param(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        if value is None:
            return None
        if value.tzinfo is None:
            raise ValueError("a moment without a time zone")
        return value.astimezone(UTC).replace(tzinfo=None)

    def process_result_value(self, value: datetime | None, dialect: Dialect) -> datetime | None:
        return None if value is None else value.replace(tzinfo=UTC)


class Base(DeclarativeBase):
    """Common ground of all tables; constraint names are fixed so that migrations can find them."""

    metadata = MetaData(
        naming_convention={
            "ix": "ix_%(column_0_label)s",
            "uq": "uq_%(table_name)s_%(column_0_name)s",
            "fk": "fk_%(table_name)s_%(column_0_name)s_%(referred_table_name)s",
            "pk": "pk_%(table_name)s",
        }
    )
    type_annotation_map: ClassVar[dict[Any, Any]] = {
        datetime: UtcDateTime,
        dict[str, Any]: JSON,
        list[Any]: JSON,
        bytes: LargeBinary,
    }


class Device(Base):
    """A sensor that once said hello."""

    __tablename__ = "devices"
    id: Mapped[int] = mapped_column(primary_key=True)
    name: Mapped[str] = mapped_column(String(80), unique=True)
    profile: Mapped[str] = mapped_column(String(40))
    firmware: Mapped[str] = mapped_column(String(40))
    simulated: Mapped[bool]
    dictionary_hash: Mapped[str] = mapped_column(String(64))
    first_seen: Mapped[datetime]
    last_seen: Mapped[datetime]


class Contact(Base):
    """From opening the line to closing it."""

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


class Command(Base):
    """A command as drafted, with its bytes and its fate."""

    __tablename__ = "commands"
    id: Mapped[int] = mapped_column(primary_key=True)
    contact_id: Mapped[int | None] = mapped_column(ForeignKey("contacts.id"), index=True)
    request_id: Mapped[int] = mapped_column(BigInteger, index=True)  # 32 bits unsigned on the wire
    name: Mapped[str] = mapped_column(String(60))
    arguments: Mapped[dict[str, Any]]
    user: Mapped[str] = mapped_column(String(60))
    source: Mapped[str] = mapped_column(String(20))
    created: Mapped[datetime]
    finished: Mapped[datetime | None]
    result: Mapped[str] = mapped_column(String(20))
    detail: Mapped[str] = mapped_column(Text, default="")
    late: Mapped[bool] = mapped_column(default=False)
    attempts: Mapped[int] = mapped_column(default=1)
    resolved_note: Mapped[str] = mapped_column(Text, default="")
    values: Mapped[dict[str, Any]] = mapped_column(default=dict)
    run_id: Mapped[int | None] = mapped_column(ForeignKey("stack_runs.id"), index=True)
    stages: Mapped[list[CommandStage]] = relationship(
        order_by="CommandStage.id", lazy="selectin", cascade="all, delete-orphan"
    )


class CommandStage(Base):
    """One report in a command's life."""

    __tablename__ = "command_stages"
    id: Mapped[int] = mapped_column(primary_key=True)
    command_id: Mapped[int] = mapped_column(ForeignKey("commands.id"), index=True)
    stage: Mapped[str] = mapped_column(String(20))
    at: Mapped[datetime]
    detail: Mapped[str] = mapped_column(Text, default="")


class TelemetryPacket(Base):
    """One decoded packet, engineering values by field name."""

    __tablename__ = "telemetry_packets"
    id: Mapped[int] = mapped_column(primary_key=True)
    contact_id: Mapped[int | None] = mapped_column(ForeignKey("contacts.id"))
    packet: Mapped[str] = mapped_column(String(40))
    received: Mapped[datetime]
    device_time_s: Mapped[float]
    request_id: Mapped[int] = mapped_column(BigInteger)
    values: Mapped[dict[str, Any]]
    __table_args__ = (Index("ix_telemetry_packets_packet_received", "packet", "received"),)


class Frame(Base):
    """An image: what it is and where its pixels are kept. Pixels are little-endian, row by row."""

    __tablename__ = "frames"
    id: Mapped[int] = mapped_column(primary_key=True)
    contact_id: Mapped[int | None] = mapped_column(ForeignKey("contacts.id"), index=True)
    number: Mapped[int | None]
    slot: Mapped[int | None]
    source: Mapped[str] = mapped_column(String(10))
    name: Mapped[str] = mapped_column(String(200))
    taken: Mapped[datetime] = mapped_column(index=True)
    received: Mapped[datetime]
    columns: Mapped[int]
    rows: Mapped[int]
    bits: Mapped[int]
    dtype: Mapped[str] = mapped_column(String(10))
    exposure_s: Mapped[float | None]
    profile: Mapped[str | None] = mapped_column(String(40))
    mode: Mapped[str | None] = mapped_column(String(20))
    sha256: Mapped[str] = mapped_column(String(64), index=True)
    complete: Mapped[bool] = mapped_column(default=True)
    rows_held: Mapped[list[Any]] = mapped_column(default=list)
    truth: Mapped[list[Any] | None]
    bank_sha256: Mapped[str | None] = mapped_column(String(64))
    parameters: Mapped[dict[str, Any]] = mapped_column(default=dict)


class Solution(Base):
    """One result on one frame. ``detail`` holds what the overlays draw."""

    __tablename__ = "solutions"
    id: Mapped[int] = mapped_column(primary_key=True)
    frame_id: Mapped[int] = mapped_column(ForeignKey("frames.id"), index=True)
    origin: Mapped[str] = mapped_column(String(10))
    chain: Mapped[str] = mapped_column(String(30))
    version: Mapped[str] = mapped_column(String(30))
    created: Mapped[datetime]
    outcome: Mapped[str] = mapped_column(String(10))
    reason: Mapped[str] = mapped_column(Text, default="")
    quaternion: Mapped[list[Any] | None]
    sigma_rad: Mapped[list[Any] | None]
    found: Mapped[int] = mapped_column(default=0)
    matched: Mapped[int] = mapped_column(default=0)
    rejected: Mapped[int] = mapped_column(default=0)
    rms_px: Mapped[float | None]
    false_match_probability: Mapped[float | None]
    fov_rad: Mapped[list[Any] | None]
    timing_s: Mapped[dict[str, Any]] = mapped_column(default=dict)
    verdict: Mapped[str | None] = mapped_column(String(10))
    error_axis_rad: Mapped[float | None]
    error_roll_rad: Mapped[float | None]
    replay: Mapped[str | None] = mapped_column(Text)
    camera: Mapped[dict[str, Any]] = mapped_column(default=dict)
    notes: Mapped[list[Any]] = mapped_column(default=list)
    detail: Mapped[dict[str, Any]] = mapped_column(default=dict)


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


class Transfer(Base):
    """A file on its way up or down."""

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
    options: Mapped[dict[str, Any]] = mapped_column(default=dict)
    log: Mapped[list[Any]] = mapped_column(default=list)


class Job(Base):
    """Long work with progress."""

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
    request: Mapped[dict[str, Any]] = mapped_column(default=dict)
    result: Mapped[dict[str, Any]] = mapped_column(default=dict)


class Event(Base):
    """Something worth a line in the record. ``seq`` only grows."""

    __tablename__ = "events"
    seq: Mapped[int] = mapped_column(primary_key=True, autoincrement=True)
    at: Mapped[datetime] = mapped_column(index=True)
    kind: Mapped[str] = mapped_column(String(30))
    severity: Mapped[str] = mapped_column(String(10))
    text: Mapped[str] = mapped_column(Text)
    data: Mapped[dict[str, Any]] = mapped_column(default=dict)
    __table_args__ = ({"sqlite_autoincrement": True},)


class Alarm(Base):
    """A limit that was left, from its first sample until it is back and an operator has seen it. Never deleted."""

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
    """What an operator has chosen for the installation, by name: the limit set in force, changed limits."""

    __tablename__ = "choices"
    name: Mapped[str] = mapped_column(String(60), primary_key=True)
    value: Mapped[dict[str, Any]]
    changed: Mapped[datetime]
    user: Mapped[str] = mapped_column(String(60))


class Authority(Base):
    """Who may command, from taking to releasing. The open row, if any, is the holder."""

    __tablename__ = "authorities"
    id: Mapped[int] = mapped_column(primary_key=True)
    holder: Mapped[str] = mapped_column(String(60))
    taken: Mapped[datetime]
    ended: Mapped[datetime | None] = mapped_column(index=True)
    ended_by: Mapped[str] = mapped_column(String(60), default="")
    reason: Mapped[str] = mapped_column(Text, default="")


class Stack(Base):
    """A prepared list of commands. ``steps``: name, arguments, delay, condition of each."""

    __tablename__ = "stacks"
    id: Mapped[int] = mapped_column(primary_key=True)
    name: Mapped[str] = mapped_column(String(80), unique=True)
    note: Mapped[str] = mapped_column(Text, default="")
    steps: Mapped[list[Any]]
    author: Mapped[str] = mapped_column(String(60))
    changed: Mapped[datetime]


class StackRun(Base):
    """One run of a stack: the steps as they were then, and how far it came."""

    __tablename__ = "stack_runs"
    id: Mapped[int] = mapped_column(primary_key=True)
    stack_id: Mapped[int | None] = mapped_column(ForeignKey("stacks.id", ondelete="SET NULL"))
    name: Mapped[str] = mapped_column(String(80))
    steps: Mapped[list[Any]]
    state: Mapped[str] = mapped_column(String(12), index=True)
    step: Mapped[int] = mapped_column(default=0)
    reason: Mapped[str] = mapped_column(Text, default="")
    user: Mapped[str] = mapped_column(String(60))
    started: Mapped[datetime]
    finished: Mapped[datetime | None]


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

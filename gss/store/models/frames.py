"""Frames and their solutions."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from sqlalchemy import JSON, Dialect, ForeignKey, Index, String, Text, TypeDecorator, false, text
from sqlalchemy.orm import Mapped, mapped_column

from gss.domain.json_object import JsonObject
from gss.store.models.base import Base
from gss.store.packed_detail import packed, unpacked


class PackedDetail(TypeDecorator[JsonObject]):
    """JSON document whose lists ``regions`` and ``stars`` are packed in the database."""

    impl = JSON
    cache_ok = True

    def process_bind_param(self, value: JsonObject | None, dialect: Dialect) -> JsonObject | None:
        return value if value is None else packed(value)

    def process_result_value(self, value: JsonObject | None, dialect: Dialect) -> JsonObject | None:
        return value if value is None else unpacked(value)


class Frame(Base):
    """Frame: its metadata and the hash of its pixels. Pixels are little-endian, row by row. ``pixels_removed``: time
    when retention deleted the pixels; ``favourite``: true if retention must keep them. ``profile`` and
    ``instrument_version``: name and version (SHA-256) of the instrument; null: unknown. ``stored_bytes``: size of the
    pixels in the store; null in rows of schemas before 0011, whose pixels are not compressed. ``time_known``: false if the
    imported file or the device does not state a time; ``taken`` is then the time of the import or download."""

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
    parameters: Mapped[JsonObject] = mapped_column(default=dict)
    pixels_removed: Mapped[datetime | None]
    favourite: Mapped[bool] = mapped_column(default=False)
    instrument_version: Mapped[str | None] = mapped_column(String(64))
    stored_bytes: Mapped[int | None]
    time_known: Mapped[bool] = mapped_column(default=True)


class Solution(Base):
    """Result of one chain or of the device for one frame. ``detail``: regions and stars, without overlays that are
    calculated from the attitude. ``operational``: true for the ground result that pages and exports use, at most one
    per frame. ``camera_name``: assumed camera profile, "field of view" or "blind"; empty in rows of schemas before
    0007. ``options``: changed constants of the chain, NAME=VALUE, …; empty: none."""

    __tablename__ = "solutions"
    __table_args__ = (
        Index(
            "ix_solutions_operational",
            "frame_id",
            unique=True,
            sqlite_where=text("operational"),
            postgresql_where=text("operational"),
        ),
    )
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
    timing_s: Mapped[dict[str, float]] = mapped_column(default=dict)
    verdict: Mapped[str | None] = mapped_column(String(10))
    error_axis_rad: Mapped[float | None]
    error_roll_rad: Mapped[float | None]
    replay: Mapped[str | None] = mapped_column(Text)
    camera: Mapped[JsonObject] = mapped_column(default=dict)
    notes: Mapped[list[Any]] = mapped_column(default=list)
    camera_name: Mapped[str] = mapped_column(String(40), default="", server_default="")
    operational: Mapped[bool] = mapped_column(default=False, server_default=false())
    options: Mapped[str] = mapped_column(Text, default="", server_default="")
    detail: Mapped[JsonObject] = mapped_column(PackedDetail, default=dict)

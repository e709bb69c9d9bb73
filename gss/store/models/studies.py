"""Calibrations, analyses and runs of star lists, kept for comparison and reuse."""

from __future__ import annotations

from datetime import datetime

from sqlalchemy import ForeignKey, String, Text
from sqlalchemy.orm import Mapped, mapped_column

from gss.domain.json_object import JsonObject
from gss.store.models.base import Base


class Calibration(Base):
    """Camera calibration. ``request``: frames and options of the calibration; ``result``: camera, uncertainties,
    maps. ``table_id``, ``bad_pixel_table_id``: tables for the sensor, null until they are created."""

    __tablename__ = "calibrations"
    id: Mapped[int] = mapped_column(primary_key=True)
    profile: Mapped[str] = mapped_column(String(40), index=True)
    kind: Mapped[str] = mapped_column(String(20))
    name: Mapped[str] = mapped_column(String(80))
    created: Mapped[datetime]
    author: Mapped[str] = mapped_column(String(60))
    tool: Mapped[str] = mapped_column(String(40))
    request: Mapped[JsonObject]
    values: Mapped[JsonObject]
    result: Mapped[JsonObject]
    note: Mapped[str] = mapped_column(Text, default="")
    table_id: Mapped[int | None] = mapped_column(ForeignKey("device_tables.id"))
    bad_pixel_table_id: Mapped[int | None] = mapped_column(ForeignKey("device_tables.id"))


class Analysis(Base):
    """Analysis of frames or telemetry, with its request and the figures of its report."""

    __tablename__ = "analyses"
    id: Mapped[int] = mapped_column(primary_key=True)
    kind: Mapped[str] = mapped_column(String(30), index=True)
    title: Mapped[str] = mapped_column(String(120))
    created: Mapped[datetime]
    author: Mapped[str] = mapped_column(String(60))
    tool: Mapped[str] = mapped_column(String(40))
    request: Mapped[JsonObject]
    result: Mapped[JsonObject]


class ListRun(Base):
    """Uploaded file with lists of measured stars. The file and the results are blobs. ``solved`` is None, and
    ``results_sha256`` empty, until the job has ended."""

    __tablename__ = "list_runs"
    id: Mapped[int] = mapped_column(primary_key=True)
    name: Mapped[str] = mapped_column(String(120))
    created: Mapped[datetime]
    author: Mapped[str] = mapped_column(String(60))
    tool: Mapped[str] = mapped_column(String(40))
    camera: Mapped[str] = mapped_column(String(40))
    no_distortion: Mapped[bool]
    sigma_px: Mapped[float]
    epoch_jyear: Mapped[float]
    lists: Mapped[int]
    size: Mapped[int]
    sha256: Mapped[str] = mapped_column(String(64), index=True)
    solved: Mapped[int | None]
    results_sha256: Mapped[str] = mapped_column(String(64), default="", index=True)
    results_size: Mapped[int] = mapped_column(default=0)

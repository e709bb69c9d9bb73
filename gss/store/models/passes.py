"""Orbit of the spacecraft, ground stations, and pass plans."""

from __future__ import annotations

from datetime import datetime
from typing import Any

from sqlalchemy import JSON, String, Text
from sqlalchemy.orm import Mapped, mapped_column

from gss.store.models.base import Base


class OrbitSet(Base):
    """Imported orbit of the spacecraft. The newest row is the active orbit; older rows are kept as a record. ``kind``:
    tle or oem, the format of ``text``; ``source_format``: format of the imported file; ``source``: origin stated by the
    user."""

    __tablename__ = "orbit_sets"
    id: Mapped[int] = mapped_column(primary_key=True)
    spacecraft: Mapped[str] = mapped_column(String(80))
    kind: Mapped[str] = mapped_column(String(8))
    source_format: Mapped[str] = mapped_column(String(20))
    source: Mapped[str] = mapped_column(String(200), default="")
    text: Mapped[str] = mapped_column(Text)
    epoch: Mapped[datetime]
    user: Mapped[str] = mapped_column(String(60))
    added: Mapped[datetime]


class Station(Base):
    """Ground station. ``mask``: [azimuth, elevation] pairs in radians; ``line_baud`` 0: the rate that the unit reports;
    ``line_url`` "": no address is set."""

    __tablename__ = "stations"
    id: Mapped[int] = mapped_column(primary_key=True)
    name: Mapped[str] = mapped_column(String(60), unique=True)
    latitude_rad: Mapped[float]
    longitude_rad: Mapped[float]
    height_m: Mapped[float]
    min_elevation_rad: Mapped[float]
    mask: Mapped[list[list[float]]] = mapped_column(JSON)
    line_url: Mapped[str] = mapped_column(String(300), default="")
    line_baud: Mapped[int] = mapped_column(default=0)
    note: Mapped[str] = mapped_column(Text, default="")
    user: Mapped[str] = mapped_column(String(60))
    changed: Mapped[datetime]


class PassPlan(Base):
    """Ordered items for a pass, and their results. ``state``: draft, armed, running, paused, waiting (for the next
    pass), completed, failed, stopped or missed. ``items``: each with its request, estimate, state, times and the id of
    the started run or transfer. ``resume``: true to continue in the next pass. ``confirm``: names typed for hazardous
    commands when the plan was armed."""

    __tablename__ = "pass_plans"
    id: Mapped[int] = mapped_column(primary_key=True)
    name: Mapped[str] = mapped_column(String(80))
    station_id: Mapped[int]
    station: Mapped[str] = mapped_column(String(60))
    spacecraft: Mapped[str] = mapped_column(String(80))
    rise: Mapped[datetime]
    set: Mapped[datetime]
    resume: Mapped[bool] = mapped_column(default=False)
    items: Mapped[list[Any]]
    confirm: Mapped[list[Any]] = mapped_column(default=list)
    state: Mapped[str] = mapped_column(String(12), index=True)
    reason: Mapped[str] = mapped_column(Text, default="")
    author: Mapped[str] = mapped_column(String(60))
    created: Mapped[datetime]
    armed_by: Mapped[str] = mapped_column(String(60), default="")
    armed: Mapped[datetime | None]
    started: Mapped[datetime | None]
    finished: Mapped[datetime | None]

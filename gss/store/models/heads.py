"""Spacecraft with several heads, and the history of their comparison."""

from __future__ import annotations

from collections.abc import Callable
from datetime import datetime
from typing import Any

from sqlalchemy import JSON, Dialect, ForeignKey, Index, String, TypeDecorator
from sqlalchemy.orm import Mapped, mapped_column

from gss.store.models.base import Base


class CheckedJson(TypeDecorator[Any]):
    """JSON column that returns None for a damaged text, so that the other rows of a query can be read."""

    impl = JSON
    cache_ok = True

    def result_processor(self, dialect: Dialect, coltype: object) -> Callable[[Any], Any] | None:
        """Return the function that reads a stored text."""
        read = super().result_processor(dialect, coltype)

        def checked(stored: Any) -> Any:
            try:
                return stored if read is None else read(stored)
            except ValueError:
                return None

        return checked


class Spacecraft(Base):
    """Spacecraft with several heads. ``heads``: an entry for each head with the unit, ``body_from_cam`` (quaternion),
    ``sigma_rad`` of the mounting, and ``usual_rad``. ``usual_rad``: standard deviations of attitudes across and about
    the boresight, used if the sensor does not report them, or null. ``source``: on board or ground."""

    __tablename__ = "spacecraft"
    id: Mapped[int] = mapped_column(primary_key=True)
    name: Mapped[str] = mapped_column(String(40), unique=True)
    heads: Mapped[list[Any]] = mapped_column(CheckedJson)
    source: Mapped[str] = mapped_column(String(10))
    tolerance_s: Mapped[float]
    stale_s: Mapped[float]
    largest_rate_rad_s: Mapped[float | None]
    misalignment_limit_rad: Mapped[float | None]
    drift_limit_rad_s: Mapped[float | None]
    user: Mapped[str] = mapped_column(String(60))
    changed: Mapped[datetime]


class FusedRow(Base):
    """Attitude of the body from all heads at one time. ``covariance``: upper triangle, rad², in the body frame.
    ``chi2``, ``freedom`` and ``probability`` null: only one head was available."""

    __tablename__ = "fused_attitudes"
    __table_args__ = (Index("ix_fused_attitudes_spacecraft_at", "spacecraft_id", "at"),)
    id: Mapped[int] = mapped_column(primary_key=True)
    spacecraft_id: Mapped[int] = mapped_column(ForeignKey("spacecraft.id", ondelete="CASCADE"))
    at: Mapped[datetime]
    units: Mapped[list[Any]]
    quaternion: Mapped[list[Any]]
    covariance: Mapped[list[Any]]
    chi2: Mapped[float | None]
    freedom: Mapped[int | None]
    probability: Mapped[float | None]


class HeadPairRow(Base):
    """Comparison of a head with the reference head at one time, and the misalignment estimated at that time. ``state``
    (6) and ``covariance`` (21, upper triangle): state of the filter; ``lasting``: variances (3) of errors that do not
    average out; ``began``: start of the estimation."""

    __tablename__ = "head_pairs"
    __table_args__ = (Index("ix_head_pairs_spacecraft_at", "spacecraft_id", "at"),)
    id: Mapped[int] = mapped_column(primary_key=True)
    spacecraft_id: Mapped[int] = mapped_column(ForeignKey("spacecraft.id", ondelete="CASCADE"))
    at: Mapped[datetime]
    reference: Mapped[str] = mapped_column(String(24))
    unit: Mapped[str] = mapped_column(String(24))
    angle_rad: Mapped[float]
    angle_sigma_rad: Mapped[float]
    boresight_rad: Mapped[float]
    boresight_sigma_rad: Mapped[float]
    chi2: Mapped[float]
    state: Mapped[list[Any]]
    covariance: Mapped[list[Any]]
    lasting: Mapped[list[Any]]
    began: Mapped[datetime]
    samples: Mapped[int]
    restarts: Mapped[int]

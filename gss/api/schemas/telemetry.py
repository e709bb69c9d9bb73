"""Telemetry values, now and then."""

from __future__ import annotations

from typing import Literal

from gss.api.schemas.base import Out, Utc


class ValueOut(Out):
    """Latest value of one field. ``state`` already includes staleness; the page never computes it."""

    name: str
    packet: str
    title: str
    page: str
    raw: float | int | None
    value: float | int | str | None
    formatted: str
    unit: str
    state: Literal["ok", "watch", "warning", "critical", "stale", "never"]
    text: str
    at: Utc | None
    age_s: float | None


class LatestOut(Out):
    """All fields."""

    values: list[ValueOut]


class SeriesOut(Out):
    """History of one field, thinned to at most the asked number of points (min and max of each bin kept)."""

    name: str
    unit: str
    t: list[float]
    y: list[float | None]


class HistoryOut(Out):
    """History of several fields over one span; ``t`` are Unix seconds."""

    start: Utc
    end: Utc
    series: list[SeriesOut]


class CycleOut(Out):
    """Timing of one on-board iteration, milliseconds by stage."""

    iteration: int
    at: Utc
    capture_ms: float
    transfer_ms: float
    detect_ms: float
    match_ms: float
    attitude_ms: float
    total_ms: float

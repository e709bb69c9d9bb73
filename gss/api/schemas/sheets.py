"""Performance sheet: the JSON document, and the schema of it."""

from __future__ import annotations

from typing import Literal

from gss.api.schemas.base import Out


class SheetFigureOut(Out):
    """One figure with its interval, in ``unit``: arcsec, arcsec/K, arcsec/day, deg/s, deg/s², s, %, px, frames, or
    "" for a number. None: without bound."""

    name: str
    value: float | None
    low: float | None
    high: float | None
    unit: str


class SheetRowOut(Out):
    """One row. ``conditions``: under which the figures hold; ``needs``: the missing data, if it was not measured."""

    key: str
    title: str
    measured: bool
    method: str
    conditions: str
    frames: int
    needs: str
    figures: list[SheetFigureOut]


class SheetOut(Out):
    """Performance sheet of a unit. ``confidence``: of the intervals; ``subject``: frames, camera, time and chain;
    ``seed``: of the bootstrap and of simulated frames."""

    schema_name: Literal["gss-performance-sheet-1"]
    standard: str
    unit: str
    title: str
    chain: str
    source: Literal["frames", "simulated"]
    subject: str
    seed: int
    confidence: float
    rows: list[SheetRowOut]

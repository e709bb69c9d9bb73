"""Telemetry: now and then."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated

from fastapi import APIRouter, Query
from pydantic import AfterValidator

from gss.api import present
from gss.api.deps import App
from gss.api.schemas.telemetry import CycleOut, HistoryOut, LatestOut, SeriesOut

router = APIRouter(prefix="/telemetry", tags=["telemetry"])


def _with_zone(value: datetime) -> datetime:
    return value if value.tzinfo else value.replace(tzinfo=UTC)


Moment = Annotated[datetime, AfterValidator(_with_zone)]


@router.get("/latest")
def latest(app: App) -> LatestOut:
    """Every field with its state now."""
    return present.telemetry.latest(app.telemetry.values())


@router.get("/history")
def history(
    app: App,
    name: Annotated[list[str], Query(min_length=1, max_length=20)],
    start: Moment,
    end: Moment,
    points: Annotated[int, Query(ge=10, le=20000)] = 600,
) -> HistoryOut:
    """Several fields over one span, thinned so that no spike is lost."""
    series = [
        SeriesOut(name=field.name, unit=field.unit, t=t, y=y)
        for field, t, y in app.telemetry.history(name, start, end, points)
    ]
    return HistoryOut(start=start, end=end, series=series)


@router.get("/cycles")
def cycles(app: App, limit: Annotated[int, Query(ge=1, le=500)] = 12) -> list[CycleOut]:
    """Timing of the newest iterations."""
    return [present.telemetry.cycle(timed) for timed in app.telemetry.cycles(limit)]

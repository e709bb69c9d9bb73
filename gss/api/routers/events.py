"""Recorded events."""

from __future__ import annotations

from typing import Annotated

from fastapi import Query

from gss.api import present
from gss.api.api_router import api_router
from gss.api.deps import App, QueryTime
from gss.api.schemas.base import MAX_ID
from gss.api.schemas.events import EventOut

router = api_router("events")


@router.get("/events")
def list_events(
    app: App,
    after: Annotated[int, Query(ge=0, le=MAX_ID)] = 0,
    limit: Annotated[int, Query(ge=1, le=1000)] = 200,
    start: QueryTime | None = None,
    end: QueryTime | None = None,
) -> list[EventOut]:
    """Events with an id above ``after`` or, with ``start`` and ``end``, the latest events of that time range. Oldest
    first."""
    rows = app.base.bus.after(after, limit) if start is None or end is None else app.base.bus.between(start, end, limit)
    return [present.records.event(row) for row in rows]

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
    after: Annotated[int | None, Query(ge=0, le=MAX_ID)] = None,
    limit: Annotated[int, Query(ge=1, le=1000)] = 200,
    start: QueryTime | None = None,
    end: QueryTime | None = None,
) -> list[EventOut]:
    """Events from ``start`` to ``end``, each optional, oldest first: the first with a number above ``after``, or, with a time
    and without ``after``, the latest. If ``after`` is above the newest number, as after a restore of an older database, the
    latest events are returned."""
    if after is None and start is None and end is None:
        after = 0
    rows = app.base.bus.between(start, end, limit, after)
    return [present.records.event(row) for row in rows]

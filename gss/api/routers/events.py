"""The record of what happened."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query

from gss.api import present
from gss.api.deps import App
from gss.api.schemas.base import LARGEST_ID
from gss.api.schemas.events import EventOut

router = APIRouter(tags=["events"])


@router.get("/events")
def list_events(
    app: App, after: Annotated[int, Query(ge=0, le=LARGEST_ID)] = 0, limit: Annotated[int, Query(ge=1, le=1000)] = 200
) -> list[EventOut]:
    """Events after a number, oldest first."""
    return [present.records.event(row) for row in app.bus.after(after, limit)]

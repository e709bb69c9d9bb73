"""The record of what happened."""

from __future__ import annotations

from typing import Annotated

from fastapi import APIRouter, Query

from gss.api import present
from gss.api.deps import LARGEST_ID, App
from gss.api.schemas.events import ContactOut, EventOut
from gss.store import devices

router = APIRouter(tags=["events"])


@router.get("/events")
def list_events(
    app: App, after: Annotated[int, Query(ge=0, le=LARGEST_ID)] = 0, limit: Annotated[int, Query(ge=1, le=1000)] = 200
) -> list[EventOut]:
    """Events after a number, oldest first."""
    return [present.records.event(row) for row in app.bus.after(after, limit)]


@router.get("/contacts")
def list_contacts(app: App, limit: Annotated[int, Query(ge=1, le=500)] = 50) -> list[ContactOut]:
    """Newest first."""
    with app.database.unit_of_work() as session:
        return [present.records.contact(*row) for row in devices.list_contacts(session, limit)]

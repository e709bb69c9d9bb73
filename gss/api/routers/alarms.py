"""Alarms: what left its limits and has not been seen back."""

from __future__ import annotations

from datetime import timedelta
from typing import Annotated

from fastapi import APIRouter, Query

from gss.api import present
from gss.api.deps import App, RowId, User, need
from gss.api.schemas.alarms import AlarmRow, NoteIn, ShelveIn
from gss.operations.clock import utc_now

router = APIRouter(prefix="/alarms", tags=["alarms"])


@router.get("")
def list_alarms(app: App, open: bool = True, limit: Annotated[int, Query(ge=1, le=1000)] = 200) -> list[AlarmRow]:
    """Open alarms, the worst first; with ``open=false`` all of them, the newest first."""
    views = app.alarms.opened()[:limit] if open else app.alarms.newest(limit)
    return [present.alarms.alarm(view) for view in views]


@router.get("/{alarm_id}")
def read_alarm(app: App, alarm_id: RowId) -> AlarmRow:
    """One alarm."""
    return present.alarms.alarm(app.alarms.get(alarm_id))


@router.post("/{alarm_id}/acknowledge", dependencies=[need("alarms")])
def acknowledge(app: App, user: User, alarm_id: RowId, body: NoteIn) -> AlarmRow:
    """Somebody has seen it."""
    return present.alarms.alarm(app.alarms.acknowledge(alarm_id, user=user, note=body.note))


@router.post("/{alarm_id}/shelve", dependencies=[need("alarms")])
def shelve(app: App, user: User, alarm_id: RowId, body: ShelveIn) -> AlarmRow:
    """Do not show it for a time."""
    until = utc_now() + timedelta(minutes=body.minutes)
    return present.alarms.alarm(app.alarms.shelve(alarm_id, until, user=user, note=body.note))


@router.post("/{alarm_id}/unshelve", dependencies=[need("alarms")])
def unshelve(app: App, user: User, alarm_id: RowId, body: NoteIn) -> AlarmRow:
    """Show it again."""
    return present.alarms.alarm(app.alarms.unshelve(alarm_id, user=user, note=body.note))


@router.post("/{alarm_id}/clear", dependencies=[need("alarms")])
def clear(app: App, user: User, alarm_id: RowId, body: NoteIn) -> AlarmRow:
    """Close it by hand, unless its cause is still there."""
    return present.alarms.alarm(app.alarms.clear(alarm_id, user=user, note=body.note))

"""Alarms: read, acknowledge, shelve and clear."""

from __future__ import annotations

from datetime import timedelta
from typing import Annotated

from fastapi import Query

from gss.api import present
from gss.api.api_router import api_router
from gss.api.deps import App, AuditNote, RowId, User, need
from gss.api.schemas.alarms import AlarmRow, NoteIn, ShelveIn
from gss.wiring.services import Services

router = api_router("alarms", "/alarms")


@router.get("")
def list_alarms(app: App, open: bool = True, limit: Annotated[int, Query(ge=1, le=1000)] = 200) -> list[AlarmRow]:
    """Open alarms, worst first; with ``open=false`` all alarms, newest first."""
    views = app.telemetry.alarms.opened()[:limit] if open else app.telemetry.alarms.newest(limit)
    return [present.alarms.alarm(view) for view in views]


@router.get("/{alarm_id}")
def read_alarm(app: App, alarm_id: RowId) -> AlarmRow:
    """Return one alarm."""
    return present.alarms.alarm(app.telemetry.alarms.get(alarm_id))


@router.post("/{alarm_id}/acknowledge", dependencies=[need("alarms")])
def acknowledge(app: App, user: User, alarm_id: RowId, body: NoteIn, audit_note: AuditNote) -> AlarmRow:
    """Acknowledge an alarm."""
    audit_note(_described(app, alarm_id), body.note)
    return present.alarms.alarm(app.telemetry.alarms.acknowledge(alarm_id, user=user, note=body.note))


@router.post("/{alarm_id}/shelve", dependencies=[need("alarms")])
def shelve(app: App, user: User, alarm_id: RowId, body: ShelveIn, audit_note: AuditNote) -> AlarmRow:
    """Hide an alarm for a limited time."""
    audit_note(_described(app, alarm_id), f"for {body.minutes:g} min", body.note)
    until = app.base.clock.now() + timedelta(minutes=body.minutes)
    return present.alarms.alarm(app.telemetry.alarms.shelve(alarm_id, until, user=user, note=body.note))


@router.post("/{alarm_id}/unshelve", dependencies=[need("alarms")])
def unshelve(app: App, user: User, alarm_id: RowId, body: NoteIn, audit_note: AuditNote) -> AlarmRow:
    """Show a shelved alarm again."""
    audit_note(_described(app, alarm_id), body.note)
    return present.alarms.alarm(app.telemetry.alarms.unshelve(alarm_id, user=user, note=body.note))


@router.post("/{alarm_id}/clear", dependencies=[need("alarms")])
def clear(app: App, user: User, alarm_id: RowId, body: NoteIn, audit_note: AuditNote) -> AlarmRow:
    """Close an alarm manually. Rejected while its cause persists."""
    audit_note(_described(app, alarm_id), body.note)
    return present.alarms.alarm(app.telemetry.alarms.clear(alarm_id, user=user, note=body.note))


def _described(app: Services, alarm_id: int) -> str:
    """Return field, level and state of the alarm for the audit log."""
    row = present.alarms.alarm(app.telemetry.alarms.get(alarm_id))
    return f"{row.packet}.{row.field}, {row.level}, {'shelved' if row.shelved else row.state};"

"""Time-tagged commands stored on board."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Annotated

from fastapi import Path

from gss.api import present
from gss.api.api_router import api_router
from gss.api.deps import App, AuditNote, User, need
from gss.api.schemas.commands import CommandOut
from gss.api.schemas.schedule import ScheduleCheckIn, ScheduleCheckOut, ScheduleIn, ScheduleOut
from gss.operations.clock import iso_z

router = api_router("schedule")
ScheduleId = Annotated[int, Path(ge=1, le=2**32 - 1)]


@router.get("/schedule")
def read_schedule(app: App) -> ScheduleOut:
    """Schedule as last reported by the device, with the clock correlation. Nothing is sent."""
    return present.schedule.schedule(app.commanding.schedule.state())


@router.post("/schedule/refresh", status_code=201, dependencies=[need("schedule")])
def refresh_schedule(app: App, user: User) -> CommandOut:
    """Request the schedule from the device."""
    return present.commands.command(app.commanding.commands.view(app.commanding.schedule.refresh(user=user)))


@router.post("/schedule/check", dependencies=[need("view", changes=False)])
def check_schedule(app: App, body: ScheduleCheckIn) -> ScheduleCheckOut:
    """Dry run of SCHEDULE for a command at a given time."""
    plan = app.commanding.schedule.plan(body.command, body.arguments, at=_utc(body.at), at_device_s=body.at_device_s)
    groups = (
        app.commanding.commands.preview(app.line.link.session.encode(app.commanding.schedule.command(), plan.order))
        if plan.order
        else []
    )
    return present.schedule.plan(plan, groups, list(plan.order))


@router.post("/schedule", status_code=201, dependencies=[need("schedule")])
def schedule_command(app: App, body: ScheduleIn, user: User, audit_note: AuditNote) -> CommandOut:
    """Add a command to the device's schedule."""
    at = _utc(body.at)
    when = f"at {iso_z(at)}" if at else f"at device time {body.at_device_s} s"
    audit_note(body.command, *(f"{name}={value}" for name, value in body.arguments.items()), when)
    row = app.commanding.schedule.send(
        body.command, body.arguments, at=_utc(body.at), at_device_s=body.at_device_s, confirm=body.confirm, user=user
    )
    return present.commands.command(app.commanding.commands.view(row))


@router.post("/schedule/cancel-all", status_code=201, dependencies=[need("schedule")])
def cancel_all(app: App, user: User) -> CommandOut:
    """Cancel all scheduled commands."""
    return present.commands.command(app.commanding.commands.view(app.commanding.schedule.cancel_all(user=user)))


@router.post("/schedule/{schedule_id}/cancel", status_code=201, dependencies=[need("schedule")])
def cancel_one(app: App, schedule_id: ScheduleId, user: User) -> CommandOut:
    """Cancel one scheduled command."""
    return present.commands.command(
        app.commanding.commands.view(app.commanding.schedule.cancel(schedule_id, user=user))
    )


def _utc(time: datetime | None) -> datetime | None:
    return time if time is None or time.tzinfo else time.replace(tzinfo=UTC)

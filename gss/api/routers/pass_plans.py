"""Pass plans: create, arm, stop, rehearse, and read their progress."""

from __future__ import annotations

from datetime import UTC
from typing import Annotated

from fastapi import Query

from gss.api import present
from gss.api.api_router import api_router
from gss.api.deps import App, AuditNote, RowId, User, need
from gss.api.schemas.passes import ArmIn, PlanIn, PlanItemIn, PlanOut, RehearsalOut
from gss.domain.errors import GssError
from gss.operations.accounts.permissions import STOP
from gss.operations.passes.plan_items import PlanItem
from gss.operations.rehearsals.rehearsal_report import REPORT, RehearsalOptions
from gss.store.models import Job, PassPlan
from gss.wiring.services import Services

router = api_router("passes")
Limit = Annotated[int, Query(ge=1, le=200)]
ReportLimit = Annotated[int, Query(ge=1, le=20)]
"""Maximum number of rehearsals in a response, because each rehearsal is returned with its complete report."""


@router.get("/pass-plans")
def list_plans(app: App, user: User, limit: Limit = 20) -> list[PlanOut]:
    """Pass plans, newest first."""
    return [_shown(app, row, user) for row in app.passes.plans.newest(limit)]


@router.get("/pass-plans/active")
def list_active_plans(app: App) -> list[PlanOut]:
    """Plans that are armed or in progress, by rise."""
    return [present.passes.plan(row) for row in app.passes.plans.active()]


@router.post("/pass-plans", status_code=201, dependencies=[need("passes")])
def create_plan(app: App, body: PlanIn, user: User, audit_note: AuditNote) -> PlanOut:
    """Store a plan for a pass. Nothing is sent until the plan is armed."""
    at = body.at if body.at.tzinfo else body.at.replace(tzinfo=UTC)
    audit_note(f"{body.name} at {at:%Y-%m-%dT%H:%M:%SZ}", *(item.kind for item in body.items))
    items = [_item(item) for item in body.items]
    row = app.passes.plans.create(body.name, body.station_id, at, items, resume=body.resume, user=user)
    return _shown(app, row, user)


@router.get("/pass-plans/{plan_id}")
def read_plan(app: App, plan_id: RowId, user: User) -> PlanOut:
    """One pass plan with planned and actual times of its items."""
    return _shown(app, app.passes.plans.get(plan_id), user)


@router.delete("/pass-plans/{plan_id}", status_code=204, dependencies=[need("passes")])
def delete_plan(app: App, plan_id: RowId, audit_note: AuditNote) -> None:
    """Delete a draft. Plans that were armed cannot be deleted."""
    audit_note(app.passes.plans.get(plan_id).name)
    app.passes.plans.delete(plan_id)


@router.post("/pass-plans/{plan_id}/arm", dependencies=[need("passes")])
def arm_plan(app: App, plan_id: RowId, body: ArmIn, user: User, audit_note: AuditNote) -> PlanOut:
    """Arm a draft. It starts with the first good packet of its pass. Needs command authority."""
    row = app.passes.plans.get(plan_id)
    audit_note(row.name, f"for {row.rise:%Y-%m-%dT%H:%M:%SZ}", *(str(item["title"]) for item in row.items))
    return present.passes.plan(app.passes.plans.arm(plan_id, body.confirm, user=user))


@router.post("/pass-plans/{plan_id}/stop", dependencies=[need(STOP)])
def stop_plan(app: App, plan_id: RowId, user: User, audit_note: AuditNote) -> PlanOut:
    """Stop a plan that is armed or in progress. Like ABORT, it needs no command authority."""
    audit_note(app.passes.plans.get(plan_id).name)
    return present.passes.plan(app.passes.runner.stop(plan_id, user=user))


@router.post("/pass-plans/{plan_id}/rehearsals", status_code=202, dependencies=[need("passes")])
def rehearse_plan(app: App, plan_id: RowId, body: RehearsalOptions, user: User, audit_note: AuditNote) -> RehearsalOut:
    """Carry out a plan on a simulated unit, in a separate process and faster than real time. Nothing reaches the
    unit."""
    audit_note(app.passes.plans.get(plan_id).name)
    return _rehearsal(app.passes.rehearsals.start(plan_id, body, user=user))


@router.get("/pass-plans/{plan_id}/rehearsals")
def list_rehearsals(app: App, plan_id: RowId, limit: ReportLimit = 5) -> list[RehearsalOut]:
    """Rehearsals of a plan, newest first."""
    return [_rehearsal(job) for job in app.passes.rehearsals.newest(plan_id, limit)]


def _rehearsal(job: Job) -> RehearsalOut:
    report = (job.result or {}).get("report")
    return RehearsalOut(job=present.records.job(job), report=None if report is None else REPORT.validate_python(report))


def _item(item: PlanItemIn) -> PlanItem:
    return PlanItem(title="", **item.model_dump())


def _shown(app: Services, row: PassPlan, user: str) -> PlanOut:
    if row.state != "draft":
        return present.passes.plan(row)
    problems, confirm = app.passes.plans.problems(row), list[str]()
    try:
        confirm = app.passes.plans.to_confirm(row, user=user)
    except GssError as error:
        problems.append(str(error))
    return present.passes.plan(row, problems, confirm)

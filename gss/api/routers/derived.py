"""Derived parameters: expressions over telemetry with their own limits and history."""

from __future__ import annotations

from gss.api import present
from gss.api.api_router import api_router
from gss.api.deps import App, AuditNote, User, need
from gss.api.schemas.jobs import JobOut
from gss.api.schemas.telemetry import DerivedOut, ExpressionIn, SpanIn, TrialOut
from gss.operations.telemetry.derived import DerivedRequest

router = api_router("telemetry", "/telemetry/derived")


@router.get("")
def list_derived(app: App) -> list[DerivedOut]:
    """Derived parameters, by name."""
    return [
        present.telemetry.derived(app.telemetry.telemetry.derived, row)
        for row in app.telemetry.telemetry.derived.list_all()
    ]


@router.post("/check", dependencies=[need("view", changes=False)])
def try_expression(app: App, body: ExpressionIn) -> TrialOut:
    """Evaluate an expression with the latest values. Nothing is stored."""
    kind, references, result = app.telemetry.telemetry.derived.trial(
        body.expression, app.telemetry.telemetry.newest_values
    )
    return TrialOut(kind=kind, references=list(references), value=result.value, reason=result.reason)


@router.post("", status_code=201, dependencies=[need("derived")])
def add_derived(app: App, user: User, body: DerivedRequest, audit_note: AuditNote) -> DerivedOut:
    """Store a new derived parameter. The server computes it from the next packet on."""
    audit_note(f"{body.name} = {body.expression}")
    row = app.telemetry.telemetry.derived.add(body, user=user)
    return present.telemetry.derived(app.telemetry.telemetry.derived, row)


@router.put("/{name}", dependencies=[need("derived")])
def change_derived(app: App, user: User, name: str, body: DerivedRequest, audit_note: AuditNote) -> DerivedOut:
    """Replace a definition. Its history keeps the values of the earlier one until it is recomputed."""
    audit_note(f"{name} from {app.telemetry.telemetry.derived.get(name).expression} to {body.expression}")
    row = app.telemetry.telemetry.derived.change(name, body, user=user)
    return present.telemetry.derived(app.telemetry.telemetry.derived, row)


@router.delete("/{name}", status_code=204, dependencies=[need("derived")])
def delete_derived(app: App, user: User, name: str, audit_note: AuditNote) -> None:
    """Delete a definition; its stored history is kept."""
    audit_note(f"{name} = {app.telemetry.telemetry.derived.get(name).expression}")
    app.telemetry.telemetry.derived.delete(name, user=user)


@router.post("/{name}/recompute", status_code=202, dependencies=[need("derived")])
def recompute(app: App, user: User, name: str, body: SpanIn, audit_note: AuditNote) -> JobOut:
    """Recompute the stored values of a time range with the current definition, as a job."""
    audit_note(f"{name} from {body.start.isoformat()} to {body.end.isoformat()}")
    return present.records.job(app.telemetry.derived_history.recompute(name, body.start, body.end, user=user))

"""Procedures: store, check, run step by step, and export the frozen record."""

from __future__ import annotations

from typing import Annotated

from fastapi import Query, Response

from gss.api import present
from gss.api.api_router import api_router
from gss.api.deps import EXPORT, App, AuditNote, RowId, User, need
from gss.api.schemas.base import MAX_ID
from gss.api.schemas.procedures import (
    AutomaticIn,
    ProcedureChangeIn,
    ProcedureCheckOut,
    ProcedureRunDetailOut,
    ProcedureRunOut,
    ProceduresOut,
    ProcedureStartIn,
    ProcedureTextIn,
    ReasonIn,
    StepRunIn,
    StepSkipIn,
    StoredProcedureOut,
)
from gss.operations.accounts.permissions import STOP
from gss.operations.procedures.run_record import record_bytes
from gss.store.models import ProcedureRun
from gss.wiring.services import Services

router = api_router("procedures")
Limit = Annotated[int, Query(ge=1, le=200)]
QueryId = Annotated[int | None, Query(ge=1, le=MAX_ID)]
NEED = need("procedures")


@router.get("/procedures")
def list_procedures(app: App) -> ProceduresOut:
    """Stored procedures, and the procedures in the configured instrument package."""
    return present.procedures.all_procedures(app.procedures.procedures)


@router.post("/procedures", status_code=201, dependencies=[NEED])
def add_procedure(app: App, body: ProcedureTextIn, user: User, audit_note: AuditNote) -> StoredProcedureOut:
    """Store a procedure. It can contain mistakes, but then it cannot be started."""
    audit_note(body.text.partition("\n")[0][:200])
    return present.procedures.procedure(
        app.procedures.procedures, app.procedures.procedures.create(body.text, user=user)
    )


@router.post("/procedures/check", dependencies=[need("view", changes=False)])
def check_procedure(app: App, body: ProcedureTextIn) -> ProcedureCheckOut:
    """Parse a procedure and return its steps and mistakes. Nothing is stored."""
    return present.procedures.check(app.procedures.procedures.check(body.text), app.line.link.roles.operations)


@router.put("/procedures/{procedure_id}", dependencies=[NEED])
def change_procedure(
    app: App, procedure_id: RowId, body: ProcedureChangeIn, user: User, audit_note: AuditNote
) -> StoredProcedureOut:
    """Replace the text of a procedure. Runs keep the text with which they were started. 409 if another user has changed the
    procedure in the meantime."""
    old = app.procedures.procedures.get(procedure_id)
    audit_note(f"{old.name}: from {len(old.text)} to {len(body.text)} characters")
    row = app.procedures.procedures.change(procedure_id, body.text, sha256=body.sha256, user=user)
    return present.procedures.procedure(app.procedures.procedures, row)


@router.delete("/procedures/{procedure_id}", status_code=204, dependencies=[NEED])
def delete_procedure(app: App, procedure_id: RowId, audit_note: AuditNote) -> None:
    """Delete a procedure; the records of its runs are kept."""
    audit_note(app.procedures.procedures.get(procedure_id).name)
    app.procedures.procedures.delete(procedure_id)


@router.post("/procedures/{procedure_id}/start", status_code=201, dependencies=[NEED])
def start_procedure(
    app: App, procedure_id: RowId, body: ProcedureStartIn, user: User, audit_note: AuditNote
) -> ProcedureRunDetailOut:
    """Start a run. Commands are sent only when a step is run, or immediately if the run is automatic. An automatic start is
    rejected if the user does not have the permission for one of the commands. 409 if the text is not the one with the stated
    hash."""
    audit_note(app.procedures.procedures.get(procedure_id).name, "automatic" if body.automatic else "", *body.confirm)
    row = app.procedures.runs.begin(
        procedure_id, user=user, sha256=body.sha256, automatic=body.automatic, confirmed=body.confirm
    )
    return _detail(app, row)


@router.get("/procedure-runs")
def list_procedure_runs(
    app: App, limit: Limit = 20, procedure_id: QueryId = None, before: QueryId = None
) -> list[ProcedureRunOut]:
    """Runs of procedures, newest first. ``procedure_id``: only runs of this procedure; ``before``: only runs started before
    the run with this id."""
    return [present.procedures.run(row) for row in app.procedures.runs.newest(limit, procedure_id, before)]


@router.get("/procedure-runs/{run_id}")
def read_procedure_run(app: App, run_id: RowId) -> ProcedureRunDetailOut:
    """One run with the steps of its procedure."""
    return _detail(app, app.procedures.runs.get(run_id))


@router.get("/procedure-runs/{run_id}/record.json", response_class=Response, dependencies=[EXPORT])
def export_record(app: App, run_id: RowId) -> Response:
    """Record of a run as canonical JSON; for an ended run, the SHA-256 of these bytes is the stored hash."""
    headers = {"Content-Disposition": f"attachment; filename=procedure-run-{run_id}.json"}
    return Response(record_bytes(app.procedures.runs.get(run_id)), media_type="application/json", headers=headers)


@router.post("/procedure-runs/{run_id}/step", dependencies=[NEED])
def run_step(app: App, run_id: RowId, body: StepRunIn, user: User, audit_note: AuditNote) -> ProcedureRunDetailOut:
    """Run the current step: evaluate, send, wait, answer, confirm or sign."""
    audit_note(app.procedures.runs.get(run_id).name, body.step, body.answer)
    row = app.procedures.runs.run_step(
        run_id, body.step, user=user, answer=body.answer, confirm=body.confirm, note=body.note
    )
    return _detail(app, row)


@router.post("/procedure-runs/{run_id}/skip", dependencies=[NEED])
def skip_step(app: App, run_id: RowId, body: StepSkipIn, user: User, audit_note: AuditNote) -> ProcedureRunDetailOut:
    """Skip the current step. The reason is recorded."""
    audit_note(app.procedures.runs.get(run_id).name, body.step, body.reason)
    return _detail(app, app.procedures.runs.skip(run_id, body.step, body.reason, user=user))


@router.post("/procedure-runs/{run_id}/automatic", dependencies=[NEED])
def set_automatic(
    app: App, run_id: RowId, body: AutomaticIn, user: User, audit_note: AuditNote
) -> ProcedureRunDetailOut:
    """Run the following steps automatically on behalf of this user until a step needs a person, or switch that off."""
    audit_note(app.procedures.runs.get(run_id).name, "automatic" if body.automatic else "manual")
    return _detail(app, app.procedures.runs.set_automatic(run_id, body.automatic, user=user))


@router.post("/procedure-runs/{run_id}/pause", dependencies=[need(STOP)])
def pause_procedure(app: App, run_id: RowId, user: User, audit_note: AuditNote) -> ProcedureRunDetailOut:
    """Switch automatic execution off. The step in progress continues, and no further step is started."""
    audit_note(app.procedures.runs.get(run_id).name)
    return _detail(app, app.procedures.runs.set_automatic(run_id, False, user=user))


@router.post("/procedure-runs/{run_id}/resume", dependencies=[NEED])
def resume_procedure(app: App, run_id: RowId, user: User, audit_note: AuditNote) -> ProcedureRunDetailOut:
    """Continue a run that a restart of the server interrupted during its pass plan; a user must run its current
    step."""
    audit_note(app.procedures.runs.get(run_id).name)
    return _detail(app, app.procedures.runs.resume(run_id, user=user))


@router.post("/procedure-runs/{run_id}/stop", dependencies=[need(STOP)])
def stop_procedure(app: App, run_id: RowId, body: ReasonIn, user: User, audit_note: AuditNote) -> ProcedureRunDetailOut:
    """End a run and freeze its record. The state of a command that was already sent is still tracked."""
    audit_note(app.procedures.runs.get(run_id).name, body.reason)
    return _detail(app, app.procedures.runs.stop(run_id, body.reason, user=user))


def _detail(app: Services, row: ProcedureRun) -> ProcedureRunDetailOut:
    current, waiting = app.procedures.runs.state(row.id)
    return present.procedures.run_detail(current, waiting, app.line.link.roles.operations)

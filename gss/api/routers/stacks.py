"""Command stacks: store, dry run, run."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Annotated, Any

from fastapi import Query, Response

from gss.api import present
from gss.api.api_router import api_router
from gss.api.deps import EXPORT, App, AuditNote, RowId, User, need
from gss.api.schemas.procedures import StoredProcedureOut
from gss.api.schemas.stacks import (
    ContinueIn,
    RunIn,
    StackCheckOut,
    StackFileIn,
    StackFileOut,
    StackIn,
    StackOut,
    StackRunOut,
    StepsIn,
)
from gss.operations.accounts.permissions import STOP
from gss.operations.commanding.stacks import StackCheck
from gss.operations.procedures.stack_text import procedure_of_stack
from gss.wiring.services import Services

router = api_router("stacks")
Limit = Annotated[int, Query(ge=1, le=200)]


@router.get("/stacks")
def list_stacks(app: App) -> list[StackOut]:
    """Stacks, by name."""
    return [present.stacks.stack(row) for row in app.commanding.stacks.every()]


@router.post("/stacks", status_code=201, dependencies=[need("stacks")])
def create_stack(app: App, body: StackIn, user: User, audit_note: AuditNote) -> StackOut:
    """Store a new stack."""
    content = body.model_dump()
    audit_note(_described(content["name"], content["steps"]))
    return present.stacks.stack(
        app.commanding.stacks.create(content["name"], content["note"], content["steps"], user=user)
    )


@router.post("/stacks/import", status_code=201, dependencies=[need("stacks")])
def import_stack(app: App, body: StackFileIn, user: User, audit_note: AuditNote) -> StackOut:
    """Store a stack from a file. It is checked against this server's dictionary, even if it was exported with another
    dictionary."""
    content = body.model_dump()
    audit_note(_described(content["name"], content["steps"]))
    return present.stacks.stack(
        app.commanding.stacks.create(content["name"], content["note"], content["steps"], user=user)
    )


@router.post("/stacks/check", dependencies=[need("view", changes=False)])
def check_steps(app: App, body: StepsIn, user: User) -> StackCheckOut:
    """Dry run of steps that are not stored."""
    return _check_out(app, app.commanding.stacks.check(body.model_dump()["steps"], user=user))


@router.get("/stacks/{stack_id}")
def read_stack(app: App, stack_id: RowId) -> StackOut:
    """Return one stack."""
    return present.stacks.stack(app.commanding.stacks.get(stack_id))


@router.put("/stacks/{stack_id}", dependencies=[need("stacks")])
def change_stack(app: App, stack_id: RowId, body: StackIn, user: User, audit_note: AuditNote) -> StackOut:
    """Replace the content of a stack."""
    content, old = body.model_dump(), app.commanding.stacks.get(stack_id)
    audit_note(f"from {_described(old.name, old.steps)} to {_described(content['name'], content['steps'])}")
    row = app.commanding.stacks.change(stack_id, content["name"], content["note"], content["steps"], user=user)
    return present.stacks.stack(row)


@router.delete("/stacks/{stack_id}", status_code=204, dependencies=[need("stacks")])
def delete_stack(app: App, stack_id: RowId, audit_note: AuditNote) -> None:
    """Delete a stack. The records of its runs are kept."""
    old = app.commanding.stacks.get(stack_id)
    audit_note(_described(old.name, old.steps))
    app.commanding.stacks.delete(stack_id)


@router.get("/stacks/{stack_id}/stack.json", dependencies=[EXPORT])
def export_stack(app: App, stack_id: RowId, response: Response) -> StackFileOut:
    """Export a stack as a file."""
    response.headers["Content-Disposition"] = f"attachment; filename=stack-{stack_id}.json"
    return StackFileOut(**app.commanding.stacks.exported(stack_id))


@router.post("/stacks/{stack_id}/procedure", status_code=201, dependencies=[need("procedures")])
def make_procedure(app: App, stack_id: RowId, user: User, audit_note: AuditNote) -> StoredProcedureOut:
    """Store a procedure with the steps of a stack. The stack is kept. 409 if a procedure already has the name of the
    stack."""
    stack, procedures = app.commanding.stacks.get(stack_id), app.procedures.procedures
    audit_note(_described(stack.name, stack.steps))
    row = procedures.create(procedure_of_stack(stack.name, stack.note, stack.steps), user=user)
    return present.procedures.procedure(procedures, row)


@router.post("/stacks/{stack_id}/check", dependencies=[need("view", changes=False)])
def check_stack(app: App, stack_id: RowId, user: User) -> StackCheckOut:
    """Dry run of a stack: bytes, hazards, conditions and durations of all steps."""
    return _check_out(app, app.commanding.stacks.check(app.commanding.stacks.get(stack_id).steps, user=user))


@router.post("/stacks/{stack_id}/run", status_code=201, dependencies=[need("stacks")])
def run_stack(app: App, stack_id: RowId, body: RunIn, user: User, audit_note: AuditNote) -> StackRunOut:
    """Run a stack. ``confirm`` must name all hazardous steps."""
    stack = app.commanding.stacks.get(stack_id)
    audit_note(_described(stack.name, stack.steps))
    return present.stacks.run(app.commanding.stack_runs.run(stack_id, body.confirm, user=user))


@router.get("/stack-runs")
def list_runs(app: App, limit: Limit = 20) -> list[StackRunOut]:
    """Stack runs, newest first."""
    return [present.stacks.run(row) for row in app.commanding.stack_runs.newest(limit)]


@router.get("/stack-runs/{run_id}")
def read_run(app: App, run_id: RowId) -> StackRunOut:
    """Return one stack run."""
    return present.stacks.run(app.commanding.stack_runs.get(run_id))


@router.post("/stack-runs/{run_id}/pause", dependencies=[need(STOP)])
def pause_run(app: App, run_id: RowId, user: User) -> StackRunOut:
    """Pause a run. No further step is sent until the run is resumed."""
    return present.stacks.run(app.commanding.stack_runs.pause(run_id, user=user))


@router.post("/stack-runs/{run_id}/resume", dependencies=[need("stacks")])
def resume_run(app: App, run_id: RowId, user: User) -> StackRunOut:
    """Resume a paused run."""
    return present.stacks.run(app.commanding.stack_runs.resume(run_id, user=user))


@router.post("/stack-runs/{run_id}/stop", dependencies=[need(STOP)])
def stop_run(app: App, run_id: RowId, user: User) -> StackRunOut:
    """Stop a run. A command that was already sent is still tracked."""
    return present.stacks.run(app.commanding.stack_runs.stop(run_id, user=user))


@router.post("/stack-runs/{run_id}/go-on", dependencies=[need("stacks")])
def continue_run(app: App, run_id: RowId, body: ContinueIn, user: User, audit_note: AuditNote) -> StackRunOut:
    """Continue the last run after a failure: retry the failed step, or skip it with a reason. A retried command with an
    unknown result keeps its id."""
    row = app.commanding.stack_runs.get(run_id)
    audit_note(row.name, f"{'skip' if body.skip else 'retry'} step {row.step + 1}", body.skip)
    return present.stacks.run(
        app.commanding.stack_runs.continue_run(run_id, body.skip.strip(), body.confirm, user=user)
    )


def _described(name: str, steps: Sequence[Mapping[str, Any]]) -> str:
    return f"{name} ({', '.join(str(step['command']) for step in steps)})"


def _check_out(app: Services, result: StackCheck) -> StackCheckOut:
    return present.stacks.check(result, lambda name: [a.name for a in app.line.link.dictionary.command(name).arguments])

"""Procedures and their runs as responses."""

from __future__ import annotations

from gss.api.schemas.procedures import (
    MistakeOut,
    PackageProcedureOut,
    ProcedureBranchOut,
    ProcedureCheckOut,
    ProcedureEntryOut,
    ProcedureRunDetailOut,
    ProcedureRunOut,
    ProceduresOut,
    ProcedureStepOut,
    StoredProcedureOut,
)
from gss.domain.errors import GssError
from gss.instruments.operations import StandardOperations
from gss.operations.commanding.command_checks import risk_of
from gss.operations.procedures.document import ProcedureDocument, ProcedureStep, read_procedure
from gss.operations.procedures.procedures import ProcedureCheck, ProcedureService, hash_of
from gss.operations.procedures.run_record import entries_of, is_intact
from gss.operations.procedures.validation import command_of
from gss.store.models import Procedure, ProcedureRun


def all_procedures(service: ProcedureService) -> ProceduresOut:
    """Return all procedures that can be run or copied."""
    package = []
    for file, text in service.of_package().items():
        checked = service.check(text)
        package.append(
            PackageProcedureOut(file=file, title=checked.document.title, text=text, mistakes=len(checked.mistakes))
        )
    return ProceduresOut(stored=[procedure(service, row) for row in service.list_all()], package=package)


def procedure(service: ProcedureService, row: Procedure) -> StoredProcedureOut:
    """Return a stored procedure."""
    checked = service.check(row.text)
    return StoredProcedureOut(
        id=row.id,
        name=row.name,
        author=row.author,
        changed=row.changed,
        text=row.text,
        sha256=hash_of(row.text),
        steps=len(checked.document.steps),
        mistakes=len(checked.mistakes),
    )


def check(checked: ProcedureCheck, operations: StandardOperations) -> ProcedureCheckOut:
    """Return a parsed procedure with its mistakes."""
    return ProcedureCheckOut(
        title=checked.document.title,
        introduction=checked.document.introduction,
        steps=_steps(checked.document, operations),
        mistakes=[MistakeOut(line=m.line, text=m.text) for m in checked.mistakes],
    )


def _steps(document: ProcedureDocument, operations: StandardOperations) -> list[ProcedureStepOut]:
    return [_step(step, operations) for step in document.steps]


def _step(step: ProcedureStep, operations: StandardOperations) -> ProcedureStepOut:
    name, reason = _confirmation(step, operations)
    return ProcedureStepOut(
        id=step.id,
        title=step.title,
        text=step.text,
        kind=step.kind,
        words=step.words,
        seconds=step.seconds,
        branches=[ProcedureBranchOut(when=b.when, target=b.target) for b in step.branches],
        confirm_name=name,
        hazard_reason=reason,
    )


def _confirmation(step: ProcedureStep, operations: StandardOperations) -> tuple[str, str]:
    """Return the name that confirms a hazardous command, and the reason for the hazard. Both are empty for other
    steps."""
    if step.kind != "command" or not step.words:
        return "", ""
    try:
        risk = risk_of(operations, *command_of(step, operations))
    except GssError:  # already listed as a mistake
        return "", ""
    return (risk.name, risk.reason) if risk.needs_confirmation else ("", "")


def run(row: ProcedureRun) -> ProcedureRunOut:
    """Return a run."""
    return ProcedureRunOut(
        id=row.id,
        procedure_id=row.procedure_id,
        name=row.name,
        user=row.user,
        instrument=row.instrument,
        contact_id=row.contact_id,
        automatic=row.automatic,
        state=row.state,  # type: ignore[arg-type]  # the column contains only these values
        current=row.current,
        entries=[ProcedureEntryOut.model_validate(entry) for entry in entries_of(row)],
        reason=row.reason,
        started=row.started,
        finished=row.finished,
        sha256=row.sha256,
        intact=is_intact(row) if row.finished else None,
    )


def run_detail(row: ProcedureRun, waiting: str, operations: StandardOperations) -> ProcedureRunDetailOut:
    """Return a run with the steps of its procedure. ``waiting``: step that waits for an operator, or ""."""
    document = read_procedure(row.text)
    return ProcedureRunDetailOut(
        **dict(run(row)), waiting=waiting, introduction=document.introduction, steps=_steps(document, operations)
    )

"""Dictionary, dry runs and command history as responses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from gss.api.schemas.commands import (
    ArgumentChoiceOut,
    ArgumentOut,
    AttitudePlaceOut,
    ByteGroupOut,
    CheckOut,
    CommandDefinitionOut,
    CommandOut,
    DictionaryOut,
    FieldDefinitionOut,
    PreconditionOut,
    RolesOut,
    StageOut,
)
from gss.instruments.dictionary.definitions import CommandDefinition as Definition
from gss.instruments.operations import Operation, StandardOperations, absence
from gss.instruments.roles import Roles
from gss.operations.commanding.command_checks import DryRun, PreconditionState
from gss.operations.commanding.command_record import CommandView
from gss.operations.commanding.schedule_plan import schedulable
from gss.operations.telemetry.limit_book import LimitBook
from gss.store.models import Command

STAGES = ("queued", "released", "sent", "accepted", "started", "progress", "completed")
ENDED = ("completed", "rejected", "failed", "unknown", "resolved", "withdrawn")
TEXT_LENGTH = 120


def dictionary(
    roles: Roles,
    notes: str,
    commands: Sequence[Definition],
    preconditions: Mapping[str, Sequence[PreconditionState]],
    limits: LimitBook,
) -> DictionaryOut:
    """Return the dictionary with the commands that the device supports, the current state of their preconditions, and the
    active limits."""
    definitions = roles.operations.dictionary
    fields = [
        FieldDefinitionOut(
            name=f.name,
            packet=packet.name,
            page=f.page,
            title=f.title,
            unit=f.unit,
            decimals=f.decimals,
            watch=active.watch,
            warning=active.warning,
            critical=active.critical,
            stale_after_s=f.stale_after_s,
        )
        for packet in definitions.telemetry
        for f in packet.values
        for active in [limits.rule(packet.name, f).limits]
    ]
    shown = [definition(roles.operations, c, preconditions.get(c.name, ())) for c in commands]
    hash_hex = definitions.hash_hex
    return DictionaryOut(hash=hash_hex, notes=notes, commands=shown, telemetry=fields, roles=roles_of(roles))


def roles_of(roles: Roles) -> RolesOut:
    """Return the standard operations and quantities that the sensor supports, and an explanation for every operation
    that it lacks."""
    operations, attitude = roles.operations, roles.quantities.attitude
    return RolesOut(
        operations={operation.value: operations.require(operation).command or "" for operation in operations.names()},
        fixed={operation.value: dict(operations.require(operation).fixed) for operation in operations.names()},
        absent={operation.value: absence(operation) for operation in Operation if not operations.has(operation)},
        quantities=list(roles.quantities.names()),
        attitude=AttitudePlaceOut.model_validate(attitude, from_attributes=True) if all(attitude.quaternion) else None,
    )


def definition(
    operations: StandardOperations, command: Definition, states: Sequence[PreconditionState]
) -> CommandDefinitionOut:
    """Return a command definition."""
    arguments = [
        ArgumentOut(
            name=a.name,
            type=a.type,
            unit=a.unit,
            purpose=a.purpose,
            min=a.minimum,
            max=a.maximum,
            default=None if isinstance(a.default, bytes) else a.default,
            choices=[
                ArgumentChoiceOut(name=x.name, value=x.value, hazard=x.hazard.value, note=x.note) for x in a.choices
            ],
        )
        for a in command.arguments
    ]
    return CommandDefinitionOut(
        name=command.name,
        code=command.code,
        subsystem=command.subsystem,
        purpose=command.purpose,
        hazard=command.hazard.value,
        hazard_reason=command.hazard_reason,
        idempotent=command.idempotent,
        role=command.role,
        favourite=command.favourite,
        arguments=arguments,
        preconditions=[precondition(s) for s in states],
        accept_within_s=command.accept_s,
        complete_within_s=command.complete_s,
        simulator_only=command.simulator_only,
        schedulable=schedulable(operations, command),
    )


def precondition(state: PreconditionState) -> PreconditionOut:
    """Return a precondition with its state."""
    return PreconditionOut(text=state.text, met=state.met, value=state.value)


def check(result: DryRun, argument_names: Sequence[str]) -> CheckOut:
    """Return the result of a dry run."""
    return CheckOut(
        problems=list(result.problems),
        preconditions=[precondition(s) for s in result.preconditions],
        bytes=byte_groups(result.groups, argument_names),
        size=sum(len(data) for _, data in result.groups),
        hazard=result.risk.hazard.value,
        hazard_reason=result.risk.reason,
        confirm_name=result.risk.name,
        role=result.role,
        idempotent=result.idempotent,
        authority=result.holder,
        allowed=not result.problems,
    )


def byte_groups(groups: Sequence[tuple[str, bytes]], argument_names: Sequence[str]) -> list[ByteGroupOut]:
    """Return a packet's bytes in labelled groups."""
    return [ByteGroupOut(label=label, hex=data.hex(" "), argument=label in argument_names) for label, data in groups]


def command(view: CommandView) -> CommandOut:
    """Return a command with its stages."""
    row = view.row
    duration_s = (row.finished - row.created).total_seconds() if row.finished else None
    return CommandOut(
        id=row.id,
        contact_id=row.contact_id,
        request_id=row.request_id,
        name=row.name,
        arguments=row.arguments,
        text=arguments_text(row.arguments),
        user=row.user,
        source=row.source,
        created=row.created,
        finished=row.finished,
        duration_s=duration_s,
        stages=_stages(row),
        result=row.result,
        detail=row.detail,
        late=row.late,
        attempts=row.attempts,
        resolved_note=row.resolved_note,
        values=row.values,
        run_id=row.run_id,
        idempotent=view.idempotent,
        needs_operator=row.result == "unknown" and not view.idempotent,
        can_retry=view.can_retry,
    )


def arguments_text(arguments: Mapping[str, Any]) -> str:
    """Return the arguments as one short line for operators."""
    text = ", ".join(f"{name.rsplit('_', 1)[0] if '_' in name else name} {value}" for name, value in arguments.items())
    return text if len(text) <= TEXT_LENGTH else text[: TEXT_LENGTH - 1] + "…"


def _stages(row: Command) -> list[StageOut]:
    """Return the seven stages of a command with their states."""
    at = {stage.stage: stage.at for stage in row.stages}
    reached = max((STAGES.index(name) for name in at if name in STAGES), default=0)
    stages_out = []
    for k, name in enumerate(STAGES):
        state = "to_come"
        if k <= reached:
            state = "passed" if name in at else "skipped"
        if k == reached and row.result not in ENDED:
            state = "now"
        if k == reached + 1 and row.result in ("rejected", "failed", "withdrawn"):
            state = "failed"
        if k == reached + 1 and row.result in ("unknown", "resolved"):
            state = "unknown"
        stages_out.append(StageOut(name=name, state=state, at=at.get(name)))  # type: ignore[arg-type]  # literals by construction
    return stages_out

"""Commands: dictionary, dry run, sending and history."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from gss.api.schemas.base import In, Out, Utc
from gss.domain.json_object import JsonObject

StageName = Literal["queued", "released", "sent", "accepted", "started", "progress", "completed"]
HazardName = Literal["none", "watch", "warning", "critical"]
StageState = Literal["passed", "now", "failed", "unknown", "to_come", "skipped"]


class ArgumentChoiceOut(Out):
    """One value of an enumerated argument."""

    name: str
    value: int
    hazard: HazardName
    note: str


class ArgumentOut(Out):
    """One argument of a command."""

    name: str
    type: str
    unit: str
    purpose: str
    min: float | None
    max: float | None
    default: float | str | bool | None
    choices: list[ArgumentChoiceOut]


class PreconditionOut(Out):
    """Precondition on the device's state, with the current value of the tested field."""

    text: str
    met: bool | None
    value: str


class CommandDefinitionOut(Out):
    """One command of the dictionary."""

    name: str
    code: int
    subsystem: str
    purpose: str
    hazard: HazardName
    hazard_reason: str
    idempotent: bool
    role: str
    favourite: bool
    arguments: list[ArgumentOut]
    preconditions: list[PreconditionOut]
    accept_within_s: float
    complete_within_s: float
    simulator_only: bool
    schedulable: bool


class FieldDefinitionOut(Out):
    """One telemetry field."""

    name: str
    packet: str
    page: str
    title: str
    unit: str
    decimals: int
    watch: tuple[float | None, float | None]
    warning: tuple[float | None, float | None]
    critical: tuple[float | None, float | None]
    stale_after_s: float


class AttitudePlaceOut(Out):
    """Location of the attitude in the telemetry: ``packet``, the field names of the four components and of the outcome
    ("" if none), and the meaning of the quaternion. ``cam_from_own``: scalar-last quaternion from the sensor's frame to
    the camera frame."""

    packet: str
    quaternion: tuple[str, str, str, str]
    order: Literal["scalar_last", "scalar_first"]
    rotation: Literal["cam_from_icrs", "icrs_from_cam"]
    cam_from_own: tuple[float, float, float, float]
    outcome: str


class RolesOut(Out):
    """Operations and quantities of the sensor under their standard names. ``operations``: command by operation, "" for
    a transfer; ``fixed``: constant arguments of the command by operation; ``absent``: explanation to display for each
    missing operation; ``quantities``: names such as ``status.mode``; ``attitude``: null if the telemetry has no
    quaternion."""

    operations: dict[str, str]
    fixed: dict[str, dict[str, int | float | bool | str]]
    absent: dict[str, str]
    quantities: list[str]
    attitude: AttitudePlaceOut | None


class DictionaryOut(Out):
    """Complete dictionary. ``roles``: standard operations and quantities of the sensor; ``notes``: notes for operators
    from the instrument package."""

    hash: str
    notes: str
    commands: list[CommandDefinitionOut]
    telemetry: list[FieldDefinitionOut]
    roles: RolesOut


class CommandIn(In):
    """Command to check or send. ``confirm``: name of the command if its hazard is critical, "yes" if its hazard is
    warning."""

    name: str
    arguments: dict[str, float | int | str | bool] = Field(default_factory=dict)
    confirm: str = ""


class ByteGroupOut(Out):
    """Labelled group of consecutive bytes of the packet, before framing."""

    label: str
    hex: str
    argument: bool


class CheckOut(Out):
    """Dry run: bytes to be sent, and problems that prevent sending. ``confirm_name``: name to type if the hazard is
    critical; for SCHEDULE the name of the scheduled command. ``authority``: current holder of command authority.
    ``allowed``: true if there are no problems."""

    problems: list[str]
    preconditions: list[PreconditionOut]
    bytes: list[ByteGroupOut]
    size: int
    hazard: HazardName
    hazard_reason: str
    confirm_name: str
    role: str
    idempotent: bool
    authority: str | None
    allowed: bool


class StageOut(Out):
    """One stage of a command."""

    name: StageName
    state: StageState
    at: Utc | None


class CommandOut(Out):
    """Command with its progress. ``result``: queued … completed, rejected, failed, unknown, resolved, withdrawn.
    ``needs_operator``: true if the outcome is unknown and the command is not idempotent. ``can_retry``: true if it can
    be sent again with the same id to the unit on the line."""

    id: int
    contact_id: int | None
    request_id: int
    name: str
    arguments: JsonObject
    text: str
    user: str
    source: str
    created: Utc
    finished: Utc | None
    duration_s: float | None
    stages: list[StageOut]
    result: str
    detail: str
    late: bool
    attempts: int
    resolved_note: str
    values: JsonObject
    run_id: int | None
    idempotent: bool
    needs_operator: bool
    can_retry: bool


class AbortOut(Out):
    """Result of ABORT. ``at``: time when it was queued ahead of all other traffic. ``command``: its record; null if the
    database did not store it in time."""

    request_id: int
    at: Utc
    command: CommandOut | None


class ResolveIn(In):
    """Note that records the outcome of an unknown command."""

    note: str = Field(min_length=1, max_length=500)


class FacetsOut(Out):
    """Values that occur in the history, for the filter menus."""

    names: list[str]
    users: list[str]
    results: list[str]
    sources: list[str]

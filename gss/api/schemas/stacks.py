"""Command stacks, their dry runs and their runs."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from gss.api.schemas.base import In, Out, Utc
from gss.api.schemas.commands import ByteGroupOut, HazardName, PreconditionOut
from gss.domain.json_object import JsonObject

Operator = Literal["eq", "ne", "lt", "le", "gt", "ge"]
Plain = float | int | str | bool


class ConditionIn(In):
    """Telemetry condition for sending the command. A value received after the previous step must satisfy it within
    ``wait_s``."""

    packet: str = "housekeeping"
    field: str
    op: Operator
    value: Plain
    wait_s: float = Field(default=10.0, ge=1.0, le=86_400.0)


class StepIn(In):
    """One step: first the delay, then the condition, then the command."""

    command: str
    arguments: dict[str, Plain] = Field(default_factory=dict)
    delay_s: float = Field(default=0.0, ge=0.0, le=86_400.0)
    condition: ConditionIn | None = None
    note: str = Field(default="", max_length=500)


class StackIn(In):
    """Stack to store."""

    name: str = Field(min_length=1, max_length=80)
    note: str = Field(default="", max_length=2000)
    steps: list[StepIn] = Field(min_length=1, max_length=200)


class StackFileIn(StackIn):
    """Exported stack."""

    format: Literal["gss-stack"]
    version: Literal[1]
    dictionary: str = ""


class StepsIn(In):
    """Steps for a dry run."""

    steps: list[StepIn] = Field(min_length=1, max_length=200)


class RunIn(In):
    """Names that confirm the hazardous steps of a run."""

    confirm: list[str] = Field(default_factory=list, max_length=200)


class ContinueIn(RunIn):
    """Options for continuing a failed run. ``skip``: reason for skipping the failed step; "": retry the step."""

    skip: str = Field(default="", max_length=500)


class ConditionOut(Out):
    """Stored condition."""

    packet: str
    field: str
    op: Operator
    value: Plain
    wait_s: float


class StepOut(Out):
    """Stored step, with all arguments."""

    command: str
    arguments: JsonObject
    delay_s: float
    condition: ConditionOut | None
    note: str


class StackOut(Out):
    """Stored stack."""

    id: int
    name: str
    note: str
    steps: list[StepOut]
    author: str
    changed: Utc


class StackFileOut(Out):
    """Stack for export to another installation. ``dictionary``: hash of the dictionary with which it was exported."""

    format: str
    version: int
    dictionary: str
    name: str
    note: str
    steps: list[StepOut]


class StepCheckOut(Out):
    """Dry run of one step. ``within_s``: maximum duration, from its condition wait and the time limits of its
    reports."""

    index: int
    command: str
    text: str
    hazard: HazardName
    hazard_reason: str
    confirm_name: str
    role: str
    preconditions: list[PreconditionOut]
    problems: list[str]
    bytes: list[ByteGroupOut]
    size: int
    delay_s: float
    wait_s: float
    within_s: float


class StackCheckOut(Out):
    """Dry run of a stack. ``confirm``: names to type to run it."""

    steps: list[StepCheckOut]
    problems: list[str]
    confirm: list[str]
    size: int
    shortest_s: float
    longest_s: float


class RunStepOut(StepOut):
    """Step of a run. ``state``: waiting, delay, condition, sending, stopped, skipped, or the result of its command."""

    state: str
    command_id: int | None
    detail: str


class StackRunOut(Out):
    """Run of a stack. ``step``: index of the current or last step."""

    id: int
    stack_id: int | None
    name: str
    user: str
    state: Literal["running", "paused", "completed", "failed", "stopped"]
    step: int
    steps: list[RunStepOut]
    reason: str
    started: Utc
    finished: Utc | None

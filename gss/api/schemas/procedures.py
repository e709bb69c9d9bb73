"""Procedures and their runs."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field

from gss.api.schemas.base import In, Out, Utc
from gss.operations.procedures.document import ActionKind
from gss.operations.procedures.run_record import EntryState


class ProcedureTextIn(In):
    """Procedure as Markdown; its first heading is its name."""

    text: str = Field(max_length=100_000)


class ProcedureChangeIn(ProcedureTextIn):
    """New text of a procedure. ``sha256``: hash of the text that was changed."""

    sha256: str = Field(pattern="^[0-9a-f]{64}$")


class ProcedureBranchOut(Out):
    """Branch of a step. ``when``: expression or answer that selects the branch, or "else"."""

    when: str
    target: str


class ProcedureStepOut(Out):
    """One step. ``words``: text of its action; ``confirm_name``: name to type before its command is sent, "" if no
    confirmation is needed."""

    id: str
    title: str
    text: str
    kind: ActionKind
    words: str
    seconds: float
    branches: list[ProcedureBranchOut]
    confirm_name: str
    hazard_reason: str


class MistakeOut(Out):
    """Mistake in a procedure with its line number."""

    line: int
    text: str


class ProcedureCheckOut(Out):
    """Result of parsing a procedure. A procedure without mistakes can start."""

    title: str
    introduction: str
    steps: list[ProcedureStepOut]
    mistakes: list[MistakeOut]


class StoredProcedureOut(Out):
    """Stored procedure. ``sha256``: hash of its text."""

    id: int
    name: str
    author: str
    changed: Utc
    text: str
    sha256: str
    steps: int
    mistakes: int


class PackageProcedureOut(Out):
    """Procedure in the configured instrument package. It can be stored as a copy."""

    file: str
    title: str
    text: str
    mistakes: int


class ProceduresOut(Out):
    """Stored procedures, and procedures in the instrument package of the unit."""

    stored: list[StoredProcedureOut]
    package: list[PackageProcedureOut]


class ProcedureStartIn(In):
    """Options for the start. ``automatic``: true to run the steps automatically until a step needs a user; ``confirm``:
    names of hazardous commands that an automatic run sends without another confirmation. ``sha256``: hash of the text to
    run; "" runs the stored text."""

    automatic: bool = False
    sha256: str = Field(default="", pattern="^([0-9a-f]{64})?$")
    confirm: list[Annotated[str, Field(max_length=60)]] = Field(default_factory=list, max_length=200)


class StepRunIn(In):
    """Input for the current step. ``step``: name of the step; ``answer``: answer to a question; ``confirm``: typed name
    of a critical command, "yes" for a command with hazard warning."""

    step: str = Field(max_length=40)
    answer: str = Field(default="", max_length=200)
    confirm: str = Field(default="", max_length=60)
    note: str = Field(default="", max_length=500)


class StepSkipIn(In):
    """Step to skip, and the reason."""

    step: str = Field(max_length=40)
    reason: str = Field(min_length=1, max_length=500)


class AutomaticIn(In):
    """Automatic execution of the following steps on or off."""

    automatic: bool


class ReasonIn(In):
    """Reason for stopping a run."""

    reason: str = Field(default="", max_length=500)


class ProcedureEntryOut(Out):
    """Record of an executed step."""

    step: str
    title: str
    kind: str
    state: EntryState
    by: str
    began: str
    ended: str
    detail: str
    values: dict[str, float | bool | str | None] | None
    command_id: int | None
    due: str
    note: str


class ProcedureRunOut(Out):
    """Run of a procedure. ``current``: next step or step in progress; ``sha256``: hash of the frozen record;
    ``intact``: true if the stored record still has this hash, null until the run has ended."""

    id: int
    procedure_id: int | None
    name: str
    user: str
    instrument: str
    contact_id: int | None
    automatic: bool
    state: Literal["running", "completed", "stopped", "aborted", "interrupted"]
    current: str
    entries: list[ProcedureEntryOut]
    reason: str
    started: Utc
    finished: Utc | None
    sha256: str
    intact: bool | None


class ProcedureRunDetailOut(ProcedureRunOut):
    """Run with the steps of its procedure. ``waiting``: step that waits for an operator, "" if no step waits."""

    waiting: str
    introduction: str
    steps: list[ProcedureStepOut]

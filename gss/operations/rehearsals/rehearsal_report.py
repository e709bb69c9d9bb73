"""Options and report of a rehearsal."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime
from typing import Annotated

from pydantic import Field, TypeAdapter

from gss.operations.requests import Request

MAX_DAYS = 3.0


class Outage(Request):
    """Loss of signal in a pass. ``pass_number``: 1 for the first pass; ``after_s``: seconds after the rise; ``for_s``:
    duration."""

    pass_number: int = Field(ge=1, le=50)
    after_s: float = Field(ge=0, le=7200)
    for_s: float = Field(gt=0, le=7200)


class RehearsalOptions(Request):
    """Options of a rehearsal. ``answers``: answers to questions by step name; a step without an entry gets its first
    answer. ``person_s``: seconds that a person needs for a step. ``bit_error_rate``, ``drop_rate``: faults of the line.
    ``outages``: losses of signal."""

    answers: dict[
        Annotated[str, Field(min_length=1, max_length=40)], Annotated[str, Field(min_length=1, max_length=200)]
    ] = Field(default_factory=dict, max_length=200)
    person_s: float = Field(default=10.0, ge=0, le=3600)
    outages: list[Outage] = Field(default_factory=list, max_length=20)
    bit_error_rate: float = Field(default=0.0, ge=0, le=0.01)
    drop_rate: float = Field(default=0.0, ge=0, le=0.5)
    seed: int = Field(default=1, ge=0, le=2**31 - 1)


@dataclass(frozen=True)
class RehearsedItem:
    """An item of the plan. ``active_s``: seconds that the item ran while the plan was running; ``estimated_s``: planned
    seconds."""

    title: str
    kind: str
    state: str
    detail: str
    estimated_s: float
    active_s: float
    started: datetime | None
    finished: datetime | None


@dataclass(frozen=True)
class RehearsedPass:
    """A pass of the rehearsal. ``used_s``: seconds that the plan ran during the pass; ``bytes_up``, ``bytes_down``:
    bytes on the line."""

    rise: datetime
    set: datetime
    used_s: float
    bytes_up: int
    bytes_down: int

    @property
    def window_s(self) -> float:
        """Length of the pass in seconds."""
        return (self.set - self.rise).total_seconds()


@dataclass(frozen=True)
class Transition:
    """A change of the plan's state."""

    at: datetime
    state: str
    reason: str


@dataclass(frozen=True)
class PersonStep:
    """A step that a person runs in a real pass. ``user``: the user name under which the rehearsal ran it."""

    at: datetime
    step: str
    kind: str
    answer: str
    user: str


@dataclass(frozen=True)
class RehearsedStep:
    """An entry of the record of a procedure that the plan ran."""

    procedure: str
    step: str
    kind: str
    state: str
    detail: str
    began: datetime
    ended: datetime | None


@dataclass(frozen=True)
class RehearsalReport:
    """Result of a rehearsal. ``state``, ``reason``: final state of the plan; ``simulated_s``: simulated time from the
    first rise to the end of the plan; ``real_s``: duration of the rehearsal; ``bytes_lost``: bytes sent while no signal
    was present."""

    plan_id: int
    plan: str
    station: str
    instrument: str
    state: str
    reason: str
    simulated_s: float
    real_s: float
    bytes_lost: int
    items: list[RehearsedItem]
    passes: list[RehearsedPass]
    transitions: list[Transition]
    person: list[PersonStep]
    steps: list[RehearsedStep]


REPORT = TypeAdapter(RehearsalReport)

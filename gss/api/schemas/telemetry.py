"""Current and stored telemetry values, and their limits."""

from __future__ import annotations

from typing import Literal

from pydantic import AwareDatetime, Field

from gss.api.schemas.base import In, Out, Utc
from gss.domain.json_object import JsonObject
from gss.operations.requests import RangeValues
from gss.operations.telemetry.telemetry import FieldValue
from gss.operations.telemetry.value_format import Kind

LevelName = Literal["ok", "watch", "warning", "critical"]


class LatestOut(Out):
    """Latest values of all fields."""

    values: list[FieldValue]


class FieldChoiceOut(Out):
    """Meaning of a number in a series."""

    name: str
    value: int


class TelemetrySeriesOut(Out):
    """History of one field, thinned to at most the requested number of points, keeping the minimum and maximum of each
    bin. ``choices``: names for the numbers in ``y`` of an enumeration or a yes/no value. ``resolution_s``: 0 if all
    samples are included; otherwise samples are missing where the times are more than twice this time apart."""

    name: str
    unit: str
    t: list[float]
    y: list[float | None]
    packet: str
    title: str
    kind: Kind
    choices: list[FieldChoiceOut]
    samples: int
    thinned: bool
    resolution_s: float


class HistoryOut(Out):
    """History of several fields over one time range; ``t``: Unix seconds."""

    start: Utc
    end: Utc
    series: list[TelemetrySeriesOut]


class PacketOut(Out):
    """Stored packet with all its values and lists. ``device_time_s``: 0 if the sensor reports no time."""

    id: int
    packet: str
    received: Utc
    device_time_s: float
    contact_id: int | None
    request_id: int
    values: JsonObject


class CycleOut(Out):
    """Timing of one on-board iteration in milliseconds by stage."""

    iteration: int
    at: Utc
    capture_ms: float
    transfer_ms: float
    detect_ms: float
    match_ms: float
    attitude_ms: float
    total_ms: float


RangeOut = tuple[float | None, float | None]


class DictionaryLimitsOut(Out):
    """Limits of the dictionary, with the changes of the active limit set."""

    watch: RangeOut
    warning: RangeOut
    critical: RangeOut
    persistence: int


class LimitOut(Out):
    """Active limits of one field. ``origin``: dictionary, set (the selected limit set) or operator."""

    key: str
    packet: str
    name: str
    title: str
    unit: str
    page: str
    decimals: int
    persistence: int
    watch: RangeOut
    warning: RangeOut
    critical: RangeOut
    origin: Literal["dictionary", "set", "operator"]
    changed_by: str
    changed: Utc | None
    note: str
    dictionary: DictionaryLimitsOut


class LimitSetOut(Out):
    """A limit set of the dictionary."""

    name: str
    note: str


class LimitsOut(Out):
    """Active limit set, and the limits of every field that can have limits."""

    set: str
    sets: list[LimitSetOut]
    fields: list[LimitOut]


class LimitSetIn(In):
    """Limit set to activate."""

    name: str = Field(max_length=60)
    note: str = Field(default="", max_length=500)


class LimitIn(In):
    """Operator's limits: [low, high] of each level, null for none. ``persistence`` null: from the dictionary."""

    watch: RangeValues = Field(default=[None, None])
    warning: RangeValues = Field(default=[None, None])
    critical: RangeValues = Field(default=[None, None])
    persistence: int | None = Field(default=None, ge=1, le=255)
    note: str = Field(default="", max_length=500)


class ExpressionIn(In):
    """Expression to evaluate: ``packet.field``, numbers, + - * /, comparisons, and, or, not, abs, sqrt, min, max."""

    expression: str = Field(max_length=500)


class DerivedOut(Out):
    """Definition of a derived parameter. ``key``: name for reading its history; ``problem``: why it is not computed, ""
    if it is computed."""

    name: str
    key: str
    title: str
    expression: str
    unit: str
    decimals: int
    watch: RangeOut
    warning: RangeOut
    critical: RangeOut
    persistence: int
    author: str
    changed: Utc
    problem: str


class TrialOut(Out):
    """Value of an expression, computed from the latest telemetry. If ``value`` is null, ``reason`` states why it is unknown."""

    kind: Literal["number", "bool", "text"]
    references: list[str]
    value: float | bool | str | None
    reason: str


class SpanIn(In):
    """Time range. The end is excluded."""

    start: AwareDatetime = Field(strict=False)
    end: AwareDatetime = Field(strict=False)

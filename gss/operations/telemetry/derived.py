"""Derived parameters: expressions over telemetry, which are computed when a packet arrives and then handled as
telemetry.

The parameter ``power_w`` is the field ``power_w`` of the packet ``derived_power_w``, so that its history, limits,
alarms, plots and exports work as for any other field. It is computed whenever one of the packets that it refers to
arrives, from the latest packet of each type. A packet older than the staleness limit in its dictionary has no current
value. Derived parameters cannot refer to each other, so there are no cycles.
"""

from __future__ import annotations

import math
import re
import threading
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime

from pydantic import Field

from gss.device.session_events import Telemetry
from gss.domain.errors import BadInput, Conflict
from gss.domain.expression_parser import Quantity
from gss.domain.expressions import Evaluation, Expression, ValueKind, parse
from gss.domain.limits import PERSISTENCE_MAX, Limits
from gss.instruments.dictionary.definitions import (
    Dictionary,
    EventDefinition,
    LimitSet,
    PacketDefinition,
    TelemetryField,
    Value,
    Values,
)
from gss.operations.clock import Now
from gss.operations.events import EventBus
from gss.operations.requests import RangeValues, Request
from gss.operations.telemetry.field_definitions import TelemetryDefinitions
from gss.operations.telemetry.value_format import kind
from gss.store import derived as store
from gss.store.engine import Database
from gss.store.models import DerivedParameter

PREFIX, PAGE = "derived_", "derived"
NAME = re.compile(r"[a-z][a-z0-9_]{0,29}")
KINDS: Mapping[str, ValueKind] = {"number": "number", "bool": "bool", "enum": "text", "text": "text"}
MAX_PARAMETERS = 100
LEVELS = ("watch", "warning", "critical")
Received = Callable[[str], tuple[datetime, Values] | None]
"""Returns the latest (received, values) of a packet; None before the first packet."""


def kinds_of(definitions: TelemetryDefinitions) -> dict[str, ValueKind]:
    """Return the kind of every field that an expression can refer to, by ``packet.field``."""
    return {f"{p.name}.{f.name}": KINDS[kind(f)] for p in definitions.telemetry for f in p.values if kind(f) in KINDS}


def evaluate(
    expression: Expression, fresh_s: Mapping[str, float], received: Received, at: datetime
) -> tuple[Evaluation, dict[str, Quantity | None]]:
    """Return the value of an expression at a time, and the field values from which it was computed. ``fresh_s``: age in
    seconds up to which the values of each packet are current; 0: no limit."""
    values: dict[str, Quantity | None] = {}
    for reference in expression.references:
        latest, limit_s = received(reference.packet), fresh_s[reference.packet]
        value = None
        if latest is not None and (not limit_s or (at - latest[0]).total_seconds() <= limit_s):
            value = latest[1].get(reference.field)
        values[str(reference)] = None if isinstance(value, bytes) else value
    return expression.value(values), values


class DerivedRequest(Request):
    """Definition of a derived parameter with its limits: [low, high] of each level, null for none."""

    name: str = Field(max_length=30)
    expression: str = Field(max_length=500)
    title: str = Field(default="", max_length=80)
    unit: str = Field(default="", max_length=20)
    decimals: int = Field(default=2, ge=0, le=9)
    watch: RangeValues = Field(default=[None, None])
    warning: RangeValues = Field(default=[None, None])
    critical: RangeValues = Field(default=[None, None])
    persistence: int = Field(default=1, ge=1, le=PERSISTENCE_MAX)

    @property
    def limits(self) -> Limits:
        """Limits of the value, as for any field."""
        return Limits(*((low, high) for low, high in (self.watch, self.warning, self.critical)))


@dataclass(frozen=True)
class ComputedParameter:
    """A derived parameter with its parsed expression. ``fresh_s``: age in seconds up to which the values of each packet
    are current; 0: no limit."""

    row: DerivedParameter
    expression: Expression
    packet: PacketDefinition
    fresh_s: Mapping[str, float]

    @property
    def field(self) -> TelemetryField:
        """The only field of the parameter's packet."""
        return self.packet.values[0]

    def evaluate(self, received: Received, at: datetime) -> Evaluation:
        """Return the value at a time, computed from the latest packets."""
        return evaluate(self.expression, self.fresh_s, received, at)[0]

    def telemetry(self, result: Evaluation, device_time_s: float) -> Telemetry:
        """Return a packet with the value; an unknown value becomes NaN."""
        value: Value = math.nan if result.value is None else result.value
        value = float(value) if self.field.type == "f64" else value
        return Telemetry(self.packet.name, device_time_s, 0, {}, {self.field.name: value})


class DerivedParameters:
    """Stores the definitions, computes the values, and adds the parameters to the instrument's dictionary.
    Thread-safe."""

    def __init__(self, dictionary: Dictionary, database: Database, bus: EventBus, now: Now) -> None:
        self._dictionary, self._database, self._bus, self._now = dictionary, database, bus, now
        self._kinds = kinds_of(dictionary)
        self._lock = threading.Lock()
        self._parameters: dict[str, ComputedParameter] = {}
        self._reasons: dict[str, str] = {}
        self._listeners: list[Callable[[str], None]] = []
        self.load()

    def load(self) -> None:
        """Read the definitions from the database. A definition that the dictionary no longer supports remains stored,
        but its values are not computed."""
        parameters = {}
        for row in self.list_all():
            with suppress(BadInput):  # ``problem`` reports the reason
                parameters[row.name] = self._parameter(row)
        self._parameters = parameters

    def subscribe(self, listener: Callable[[str], None]) -> None:
        """Call ``listener`` with ``packet.name`` of each parameter whose definition changed."""
        self._listeners.append(listener)

    # --- dictionary ---------------------------------------------------------------------------------------------

    @property
    def telemetry(self) -> tuple[PacketDefinition, ...]:
        """The instrument's packets, then one per derived parameter."""
        return (*self._dictionary.telemetry, *(p.packet for p in self._parameters.values()))

    @property
    def events(self) -> tuple[EventDefinition, ...]:
        """The instrument's events."""
        return self._dictionary.events

    @property
    def limit_sets(self) -> tuple[LimitSet, ...]:
        """The instrument's limit sets."""
        return self._dictionary.limit_sets

    def packet(self, name: str) -> PacketDefinition:
        """Return the packet of that name. Raises NotFound."""
        parameter = self._parameters.get(name.removeprefix(PREFIX)) if name.startswith(PREFIX) else None
        return parameter.packet if parameter else self._dictionary.packet(name)

    def stored_packet(self, name: str) -> PacketDefinition:
        """Return a packet like ``packet``, but read derived parameters from the database, because the definitions in an
        API worker can be outdated."""
        if name.startswith(PREFIX):
            self.load()
        return self.packet(name)

    def unknown_reason(self, packet: str) -> str:
        """Return why the latest value of a derived parameter is unknown; "" if the value is known."""
        return self._reasons.get(packet, "")

    # --- definitions --------------------------------------------------------------------------------------------

    def list_all(self) -> list[DerivedParameter]:
        """Return all definitions by name."""
        with self._database.unit_of_work() as session:
            return store.list_all(session)

    def get(self, name: str) -> DerivedParameter:
        """Return the definition of that name. Raises NotFound."""
        with self._database.unit_of_work() as session:
            return store.named(session, name)

    def parameter(self, name: str) -> ComputedParameter:
        """Return the parameter of that name. Raises NotFound, or BadInput if the dictionary no longer supports it."""
        return self._parameter(self.get(name))

    @property
    def boolean_fields(self) -> frozenset[str]:
        """Names ``packet.field`` of all yes/no fields, whose values the store returns as 1 and 0."""
        return frozenset(name for name, kind in self._kinds.items() if kind == "bool")

    def problem(self, row: DerivedParameter) -> str:
        """Return why a stored definition is not computed; "" if it is computed."""
        try:
            self._parameter(row)
        except BadInput as error:
            return str(error)
        return ""

    def add(self, request: DerivedRequest, *, user: str) -> DerivedParameter:
        """Store a new definition and compute it from the next packet on. Raises BadInput, Conflict."""
        with self._lock:
            rows = self.list_all()
            if any(row.name == request.name for row in rows):
                raise Conflict("A derived parameter with this name exists", got=request.name, hint="Change it.")
            if len(rows) >= MAX_PARAMETERS:
                raise Conflict(
                    "There are too many derived parameters",
                    expected=f"at most {MAX_PARAMETERS}",
                    got=str(len(rows)),
                    hint="Delete one.",
                )
            row = self._row(DerivedParameter(name=request.name), request, user)
            with self._database.unit_of_work() as session:
                store.add(session, row)
        self._changed(row.name, f"{user} added the derived parameter {row.name} = {row.expression}")
        return row

    def change(self, name: str, request: DerivedRequest, *, user: str) -> DerivedParameter:
        """Replace a definition. The stored history does not change until it is recomputed. Raises BadInput,
        NotFound."""
        if request.name != name:
            raise BadInput("The name of a derived parameter cannot be changed", expected=name, got=request.name)
        with self._lock, self._database.unit_of_work() as session:
            row = store.named(session, name)
            before = row.expression
            self._row(row, request, user)
        self._changed(name, f"{user} changed the derived parameter {name} from {before} to {row.expression}")
        return row

    def delete(self, name: str, *, user: str) -> None:
        """Delete a definition. The stored history is kept, and is shown again if the name is defined again. Raises
        NotFound."""
        with self._lock, self._database.unit_of_work() as session:
            store.delete(session, store.named(session, name))
        self._changed(name, f"{user} deleted the derived parameter {name}")

    def _row(self, row: DerivedParameter, request: DerivedRequest, user: str) -> DerivedParameter:
        """Copy a request to a row. Raises BadInput."""
        if not NAME.fullmatch(request.name):
            raise BadInput(
                "The name of the derived parameter is invalid",
                expected="1 – 30 lower-case letters, digits and _, a letter first",
                got=request.name[:40],
            )
        limits = request.limits.checked()
        row.expression, row.title, row.unit = request.expression.strip(), request.title.strip(), request.unit.strip()
        row.decimals, row.persistence = request.decimals, request.persistence
        row.limits = {level.value: list(bounds) for level, bounds in limits.levels}
        row.author, row.changed = user, self._now()
        self._parameter(row)
        return row

    def check(self, text: str) -> tuple[Expression, ValueKind]:
        """Parse an expression and return it with the kind of its result. Raises BadInput."""
        expression = parse(text)
        kind = expression.kind(self._kinds)
        if kind == "text":
            raise BadInput("The result of the expression is text", expected="a number or yes/no")
        if not expression.references:
            raise BadInput("The expression refers to no telemetry field", expected="at least one packet.field")
        return expression, kind

    def _parameter(self, row: DerivedParameter) -> ComputedParameter:
        expression, kind = self.check(row.expression)
        fresh_s = {r.packet: self._dictionary.packet(r.packet).stale_after_s for r in expression.references}
        field = TelemetryField(
            name=row.name,
            type="bool" if kind == "bool" else "f64",
            unit=row.unit,
            purpose=row.expression,
            title=row.title or row.name,
            page=PAGE,
            decimals=row.decimals,
            limits=Limits(*((low, high) for low, high in (row.limits[level] for level in LEVELS))),
            stale_after_s=max(fresh_s.values()),
            persistence=row.persistence,
        )
        packet = PacketDefinition(PREFIX + row.name, 0, row.expression, (field,), field.stale_after_s, False)
        return ComputedParameter(row, expression, packet, fresh_s)

    def _changed(self, name: str, text: str) -> None:
        self.load()
        self._reasons.pop(PREFIX + name, None)
        for listener in self._listeners:
            listener(f"{PREFIX}{name}.{name}")
        self._bus.record("telemetry", "ok", text, parameter=name)

    # --- values -------------------------------------------------------------------------------------------------

    def computed(self, packet: Telemetry, at: datetime, received: Received) -> Sequence[Telemetry]:
        """Return a packet for each derived parameter that refers to the received packet."""
        computed = []
        for parameter in self._parameters.values():
            if packet.packet in parameter.fresh_s:
                result = parameter.evaluate(received, at)
                self._reasons[parameter.packet.name] = result.reason
                computed.append(parameter.telemetry(result, packet.device_time_s))
        return computed

    def trial(self, text: str, received: Received) -> tuple[ValueKind, Sequence[str], Evaluation]:
        """Evaluate an expression with the latest packets of any age. Return the kind of the result, the referenced
        fields and the value. Raises BadInput."""
        expression, kind = self.check(text)
        values: dict[str, Quantity | None] = {}
        for reference in expression.references:
            newest = received(reference.packet)
            value = newest[1].get(reference.field) if newest else None
            values[str(reference)] = None if isinstance(value, bytes) else value
        return kind, [str(r) for r in expression.references], expression.value(values)

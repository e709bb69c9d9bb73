"""Telemetry values, states, limits and cycle timing as responses."""

from __future__ import annotations

from collections.abc import Mapping
from datetime import datetime
from typing import Any

from gss.api.schemas.telemetry import (
    CycleOut,
    DerivedOut,
    DictionaryLimitsOut,
    FieldChoiceOut,
    LatestOut,
    LimitOut,
    LimitSetOut,
    LimitsOut,
    PacketOut,
    TelemetrySeriesOut,
)
from gss.instruments.dictionary.definitions import TelemetryField
from gss.operations.telemetry.archive import TelemetrySeries
from gss.operations.telemetry.derived import PREFIX, DerivedParameters
from gss.operations.telemetry.limit_book import LimitBook
from gss.operations.telemetry.telemetry import FieldValue
from gss.operations.telemetry.value_format import kind
from gss.store.models import DerivedParameter, TelemetryPacket


def latest(values: list[FieldValue]) -> LatestOut:
    """Return all fields with their states."""
    return LatestOut(values=values)


def series(stored: TelemetrySeries) -> TelemetrySeriesOut:
    """Return the history of one field."""
    definition = stored.definition
    choices = [FieldChoiceOut(name=c.name, value=c.value) for c in definition.choices]
    if definition.type == "bool":
        choices = [FieldChoiceOut(name="no", value=0), FieldChoiceOut(name="yes", value=1)]
    return TelemetrySeriesOut(
        name=stored.key,
        unit=definition.unit,
        t=stored.t,
        y=stored.y,
        packet=stored.packet,
        title=definition.title,
        kind=kind(definition),
        choices=choices,
        samples=stored.samples,
        thinned=stored.thinned,
        resolution_s=stored.resolution_s,
    )


def packet(row: TelemetryPacket) -> PacketOut:
    """Return a stored packet."""
    return PacketOut.model_validate(row)


def limits(book: LimitBook) -> LimitsOut:
    """Return all active limits."""
    sets = [LimitSetOut(name=name, note=note) for name, note in book.sets]
    return LimitsOut(set=book.chosen, sets=sets, fields=[limit(book, *packet_field) for packet_field in book.fields()])


def limit(book: LimitBook, packet: str, field: TelemetryField) -> LimitOut:
    """Return the active limits of one field."""
    rule, dictionary_rule = book.rule(packet, field), book.given(field)
    return LimitOut(
        key=f"{packet}.{field.name}",
        packet=packet,
        name=field.name,
        title=field.title,
        unit=field.unit,
        page=field.page,
        decimals=field.decimals,
        persistence=rule.persistence,
        watch=rule.limits.watch,
        warning=rule.limits.warning,
        critical=rule.limits.critical,
        origin=rule.origin,  # type: ignore[arg-type]  # the book uses the schema's values
        changed_by=rule.changed_by,
        changed=rule.changed,
        note=rule.note,
        dictionary=DictionaryLimitsOut(
            watch=dictionary_rule.limits.watch,
            warning=dictionary_rule.limits.warning,
            critical=dictionary_rule.limits.critical,
            persistence=dictionary_rule.persistence,
        ),
    )


def derived(book: DerivedParameters, row: DerivedParameter) -> DerivedOut:
    """Return the definition of a derived parameter."""
    return DerivedOut(
        name=row.name,
        key=f"{PREFIX}{row.name}.{row.name}",
        title=row.title,
        expression=row.expression,
        unit=row.unit,
        decimals=row.decimals,
        persistence=row.persistence,
        watch=row.limits["watch"],
        warning=row.limits["warning"],
        critical=row.limits["critical"],
        author=row.author,
        changed=row.changed,
        problem=book.problem(row),
    )


def cycle(timed: tuple[datetime, Mapping[str, Any]]) -> CycleOut:
    """Return the timing of one iteration."""
    at, values = timed
    stages = {
        f"{name}_ms": float(values[f"{name}_ms"]) for name in ("capture", "transfer", "detect", "match", "attitude")
    }
    # The next image is captured while this one is processed (Erlank 2013 §5.3.4, Fig. 5.8); only its transfer blocks
    # both.
    working_ms = stages["detect_ms"] + stages["match_ms"] + stages["attitude_ms"]
    total_ms = max(stages["capture_ms"], working_ms) + stages["transfer_ms"]
    return CycleOut(iteration=int(values["iteration"]), at=at, total_ms=total_ms, **stages)

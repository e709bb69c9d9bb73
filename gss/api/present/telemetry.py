"""Telemetry values, states, limits and cycle timing as responses."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

from gss.api.schemas.telemetry import (
    ChoiceOut,
    CycleOut,
    GivenLimitsOut,
    LatestOut,
    LimitOut,
    LimitSetOut,
    LimitsOut,
    PacketOut,
    SeriesOut,
    ValueOut,
)
from gss.device.dictionary import TelemetryField
from gss.operations.telemetry.archive import Series
from gss.operations.telemetry.limit_book import LimitBook
from gss.operations.telemetry.telemetry import FieldValue
from gss.operations.telemetry.value_words import formatted, kind, raw_text
from gss.store.models import TelemetryPacket

Told = tuple[Sequence[FieldValue], Mapping[tuple[str, str], int]]
"""Values, and the id of the open alarm of each field that has one."""


def latest(told: Told) -> LatestOut:
    """Return all fields with their states."""
    values, alarms = told
    return LatestOut(values=[value(v, alarms.get((v.packet, v.definition.name))) for v in values])


def value(v: FieldValue, alarm_id: int | None = None) -> ValueOut:
    """Return one field."""
    shown = v.value.hex() if isinstance(v.value, bytes) else v.value
    raw = v.raw if isinstance(v.raw, int | float) else None
    text = v.state
    if v.state == "stale" and v.age_s is not None:
        fresh = v.age_s <= v.definition.stale_after_s  # still received, but from an iteration that has ended
        text = "cycle stopped" if fresh else f"stale {v.age_s:.0f} s"
    return ValueOut(
        name=v.definition.name,
        packet=v.packet,
        title=v.definition.title,
        page=v.definition.page,
        kind=kind(v.definition),  # type: ignore[arg-type]  # the operations' words are the schema's, here and below
        raw=_finite(raw),
        raw_text=raw_text(v.definition, v.raw),
        value=_finite(shown) if isinstance(shown, float) else shown,
        formatted=formatted(shown, v.definition.decimals),
        unit=v.definition.unit,
        state=v.state,  # type: ignore[arg-type]  # as above
        sample_state=v.sample_state,  # type: ignore[arg-type]  # as above
        text=text,
        at=v.at,
        age_s=v.age_s,
        alarm_id=alarm_id,
    )


def _finite(x: float | None) -> float | None:
    return x if x is not None and math.isfinite(x) else None


def series(s: Series) -> SeriesOut:
    """Return the history of one field."""
    definition = s.definition
    choices = [ChoiceOut(name=c.name, value=c.value) for c in definition.choices]
    if definition.type == "bool":
        choices = [ChoiceOut(name="no", value=0), ChoiceOut(name="yes", value=1)]
    return SeriesOut(
        name=s.key,
        unit=definition.unit,
        t=s.t,
        y=s.y,
        packet=s.packet,
        title=definition.title,
        kind=kind(definition),  # type: ignore[arg-type]  # as above
        choices=choices,
        samples=s.samples,
        thinned=s.thinned,
    )


def packet(row: TelemetryPacket) -> PacketOut:
    """Return a stored packet."""
    return PacketOut.model_validate(row)


def limits(book: LimitBook) -> LimitsOut:
    """Return all limits in force."""
    sets = [LimitSetOut(name=name, note=note) for name, note in book.sets]
    return LimitsOut(set=book.chosen, sets=sets, fields=[limit(book, *where) for where in book.fields()])


def limit(book: LimitBook, packet: str, field: TelemetryField) -> LimitOut:
    """Return the limits in force for one field."""
    rule, given = book.rule(packet, field), book.given(field)
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
        origin=rule.origin,  # type: ignore[arg-type]  # as above
        changed_by=rule.changed_by,
        changed=rule.changed,
        note=rule.note,
        dictionary=GivenLimitsOut(
            watch=given.limits.watch,
            warning=given.limits.warning,
            critical=given.limits.critical,
            persistence=given.persistence,
        ),
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

"""Values, their states, and the cycle's timing."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

from gss.api.schemas.telemetry import CycleOut, LatestOut, ValueOut
from gss.operations.telemetry import FieldValue


def latest(values: Sequence[FieldValue]) -> LatestOut:
    """All fields with their states."""
    return LatestOut(values=[value(v) for v in values])


def value(v: FieldValue) -> ValueOut:
    """One field."""
    shown = v.value.hex() if isinstance(v.value, bytes) else v.value
    raw = v.raw if isinstance(v.raw, int | float) else None
    text = v.state
    if v.state == "stale" and v.age_s is not None:
        fresh = v.age_s <= v.definition.stale_after_s  # it is told again and again, from an iteration that is over
        text = "cycle stopped" if fresh else f"stale {v.age_s:.0f} s"
    return ValueOut(
        name=v.definition.name,
        packet=v.packet,
        title=v.definition.title,
        page=v.definition.page,
        raw=_finite(raw),
        value=_finite(shown) if isinstance(shown, float) else shown,
        formatted=_formatted(shown, v.definition.decimals),
        unit=v.definition.unit,
        state=v.state,  # type: ignore[arg-type]  # the service's words are the schema's
        text=text,
        at=v.at,
        age_s=v.age_s,
    )


def _formatted(shown: Any, decimals: int) -> str:
    if shown is None:
        return "–"
    if isinstance(shown, bool):
        return "yes" if shown else "no"
    if isinstance(shown, float | int):
        text = f"{shown:.{decimals}f}" if isinstance(shown, float) else str(shown)
        return text.replace("-", "−")
    return str(shown)


def _finite(x: float | None) -> float | None:
    return x if x is not None and math.isfinite(x) else None


def cycle(timed: tuple[datetime, Mapping[str, Any]]) -> CycleOut:
    """Timing of one iteration."""
    at, values = timed
    stages = {
        f"{name}_ms": float(values[f"{name}_ms"]) for name in ("capture", "transfer", "detect", "match", "attitude")
    }
    # The next image is taken while this one is worked on (Erlank 2013 §5.3.4, Fig. 5.8); only its transfer stops both.
    working_ms = stages["detect_ms"] + stages["match_ms"] + stages["attitude_ms"]
    total_ms = max(stages["capture_ms"], working_ms) + stages["transfer_ms"]
    return CycleOut(iteration=int(values["iteration"]), at=at, total_ms=total_ms, **stages)

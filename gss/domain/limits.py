"""Telemetry limits: which state a value is in."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class State(StrEnum):
    """States of a value, from calm to urgent."""

    OK = "ok"
    WATCH = "watch"
    WARNING = "warning"
    CRITICAL = "critical"


ORDER = {State.OK: 0, State.WATCH: 1, State.WARNING: 2, State.CRITICAL: 3}


@dataclass(frozen=True)
class Limits:
    """Inclusive inner ranges: outside ``watch`` is WATCH, outside ``warning`` WARNING, outside ``critical`` CRITICAL.
    None means no limit on that side or level."""

    watch: tuple[float | None, float | None] = (None, None)
    warning: tuple[float | None, float | None] = (None, None)
    critical: tuple[float | None, float | None] = (None, None)

    def state(self, value: float) -> State:
        """The worst level whose range the value leaves; NaN is CRITICAL, never silently ok."""
        if value != value:
            return State.CRITICAL
        for level, (low, high) in (
            (State.CRITICAL, self.critical),
            (State.WARNING, self.warning),
            (State.WATCH, self.watch),
        ):
            if (low is not None and value < low) or (high is not None and value > high):
                return level
        return State.OK

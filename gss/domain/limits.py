"""Telemetry limits: the state of a value, and the persistence filter that needs consecutive samples to change the state."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property

from gss.domain.errors import BadInput

Range = tuple[float | None, float | None]
OPEN: Range = (None, None)
PERSISTENCE_MAX = 255


class State(StrEnum):
    """States of a value, in order of urgency."""

    OK = "ok"
    WATCH = "watch"
    WARNING = "warning"
    CRITICAL = "critical"


ORDER = {State.OK: 0, State.WATCH: 1, State.WARNING: 2, State.CRITICAL: 3}


def worst(states: Iterable[State]) -> State:
    """Return the most urgent of the given states, or OK if there are none."""
    return max(states, key=ORDER.__getitem__, default=State.OK)


@dataclass(frozen=True)
class Limits:
    """Inclusive nested ranges: a value outside ``watch`` is WATCH, outside ``warning`` WARNING, outside ``critical``
    CRITICAL. None means no limit on that side or level."""

    watch: Range = OPEN
    warning: Range = OPEN
    critical: Range = OPEN

    @cached_property
    def levels(self) -> tuple[tuple[State, Range], ...]:
        """Levels with their ranges, most urgent first."""
        return (State.CRITICAL, self.critical), (State.WARNING, self.warning), (State.WATCH, self.watch)

    def state(self, value: float) -> State:
        """Return the most urgent level whose range does not contain the value; CRITICAL for NaN."""
        if value != value:
            return State.CRITICAL
        for level, (low, high) in self.levels:
            if (low is not None and value < low) or (high is not None and value > high):
                return level
        return State.OK

    @cached_property
    def any(self) -> bool:
        """True if any limit is set. Cached because it is read for every field of every packet."""
        return any(bound is not None for _, bounds in self.levels for bound in bounds)

    def checked(self) -> Limits:
        """Return these limits if they are valid. Raises BadInput if a range is empty or a range reaches outside a more urgent
        range."""
        for level, (low, high) in self.levels:
            if any(bound is not None and bound != bound for bound in (low, high)):
                raise BadInput(f"{level} limit is not a number", expected="a number or none")
            if low is not None and high is not None and low > high:
                raise BadInput(f"{level} limits are empty", expected="low ≤ high", got=f"{low:g} … {high:g}")
        outer_low, outer_high = None, None
        for level, (low, high) in self.levels:
            if (low is not None and outer_low is not None and low < outer_low) or (
                high is not None and outer_high is not None and high > outer_high
            ):
                raise BadInput(
                    f"{level} limits reach beyond a more urgent level", expected="watch ⊆ warning ⊆ critical"
                )
            outer_low, outer_high = (outer_low if low is None else low), (outer_high if high is None else high)
        return self


@dataclass(frozen=True)
class Persistence:
    """Filter that derives the *counted* state from consecutive samples.

    With persistence n, the counted state rises to the least urgent of the last n samples if that state is more urgent.
    It falls to the most urgent of the last n samples if that state is less urgent. Therefore n consecutive samples
    outside the limits raise the counted state, and n consecutive samples inside clear it. A different sample restarts
    the count. A single spike has no effect if n > 1. ``recent``: at most the last n − 1 samples, oldest first. A
    missing or unchecked sample interrupts the sequence of samples; see ``broken``.
    """

    counted: State = State.OK
    recent: tuple[State, ...] = field(default=())

    def after(self, sample: State, persistence: int) -> Persistence:
        """Return the filter after one more sample; ``persistence`` ≥ 1 is the number of samples that must agree."""
        if persistence < 1:
            raise BadInput("the persistence is out of range", expected=f"1 – {PERSISTENCE_MAX}", got=str(persistence))
        if sample is self.counted and self.recent == (sample,) * (persistence - 1):
            return self  # fast path for nearly all samples
        run = (*self.recent, sample)[-persistence:]
        recent = run[1:] if len(run) == persistence else run
        if len(run) < persistence:
            return Persistence(self.counted, recent)
        calmest, most_urgent = min(run, key=ORDER.__getitem__), worst(run)
        if ORDER[calmest] > ORDER[self.counted]:
            return Persistence(calmest, recent)
        if ORDER[most_urgent] < ORDER[self.counted]:
            return Persistence(most_urgent, recent)
        return self if recent == self.recent else Persistence(self.counted, recent)

    def broken(self) -> Persistence:
        """Return the filter without recent samples and with the same counted state, after a missing sample or a change of
        limits."""
        return Persistence(self.counted) if self.recent else self

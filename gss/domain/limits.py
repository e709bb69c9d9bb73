"""Telemetry limits: which state a value is in, and for how many samples it must stay there to count."""

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
    """States of a value, from calm to urgent."""

    OK = "ok"
    WATCH = "watch"
    WARNING = "warning"
    CRITICAL = "critical"


ORDER = {State.OK: 0, State.WATCH: 1, State.WARNING: 2, State.CRITICAL: 3}


def worst(states: Iterable[State]) -> State:
    """The most urgent of some states; OK of none."""
    return max(states, key=ORDER.__getitem__, default=State.OK)


@dataclass(frozen=True)
class Limits:
    """Inclusive inner ranges: outside ``watch`` is WATCH, outside ``warning`` WARNING, outside ``critical`` CRITICAL.
    None means no limit on that side or level."""

    watch: Range = OPEN
    warning: Range = OPEN
    critical: Range = OPEN

    @cached_property
    def levels(self) -> tuple[tuple[State, Range], ...]:
        """Each level with its range, the most urgent first."""
        return (State.CRITICAL, self.critical), (State.WARNING, self.warning), (State.WATCH, self.watch)

    def state(self, value: float) -> State:
        """The worst level whose range the value leaves; NaN is CRITICAL, never silently ok."""
        if value != value:
            return State.CRITICAL
        for level, (low, high) in self.levels:
            if (low is not None and value < low) or (high is not None and value > high):
                return level
        return State.OK

    @cached_property
    def any(self) -> bool:
        """Is there a limit at all? Asked for every field of every packet."""
        return any(bound is not None for _, bounds in self.levels for bound in bounds)

    def checked(self) -> Limits:
        """These limits, if each range holds something and each level lies inside the next one; BadInput otherwise."""
        for level, (low, high) in self.levels:
            if any(bound is not None and bound != bound for bound in (low, high)):
                raise BadInput(f"{level} limit is not a number", expected="a number or none")
            if low is not None and high is not None and low > high:
                raise BadInput(f"{level} limits hold nothing", expected="low ≤ high", got=f"{low:g} … {high:g}")
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
    """What a run of samples amounts to: the state that *counts*, which follows the samples only when they insist.

    With persistence n the counted state rises to the calmest of the last n samples when that is more urgent, and falls to
    the most urgent of the last n samples when that is calmer. So n consecutive samples out raise it, n consecutive samples
    in clear it, one sample between restarts the count, and a spike of one sample among n − 1 others does nothing.
    ``recent``: the last n − 1 samples at most, oldest first. A sample that is missing or not judged ends the run: ``broken``.
    """

    counted: State = State.OK
    recent: tuple[State, ...] = field(default=())

    def after(self, sample: State, persistence: int) -> Persistence:
        """The run with one sample more; ``persistence`` ≥ 1 samples must agree."""
        if persistence < 1:
            raise BadInput("persistence counts samples", expected=f"1 – {PERSISTENCE_MAX}", got=str(persistence))
        if sample is self.counted and self.recent == (sample,) * (persistence - 1):
            return self  # nearly every sample of nearly every field
        run = (*self.recent, sample)[-persistence:]
        kept = run[1:] if len(run) == persistence else run
        if len(run) < persistence:
            return Persistence(self.counted, kept)
        calmest, most_urgent = min(run, key=ORDER.__getitem__), worst(run)
        if ORDER[calmest] > ORDER[self.counted]:
            return Persistence(calmest, kept)
        if ORDER[most_urgent] < ORDER[self.counted]:
            return Persistence(most_urgent, kept)
        return self if kept == self.recent else Persistence(self.counted, kept)

    def broken(self) -> Persistence:
        """The run ends without changing what counts: a sample is missing, or the limits were changed."""
        return Persistence(self.counted) if self.recent else self

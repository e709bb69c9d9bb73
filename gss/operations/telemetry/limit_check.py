"""Checks telemetry against limits with persistence. The states depend only on the packets, so a replay of stored
packets computes the same states."""

from __future__ import annotations

import math
import sys
import threading
from collections.abc import Callable, Container, Mapping
from dataclasses import dataclass
from typing import Any, Literal

from gss.device.session_events import Telemetry
from gss.domain.limits import Persistence, State
from gss.instruments.dictionary.definitions import TelemetryField, Value
from gss.instruments.telemetry_roles import Status
from gss.operations.telemetry.field_definitions import TelemetryDefinitions
from gss.operations.telemetry.limit_book import Rule
from gss.operations.telemetry.value_format import plain

ITERATION_PAGES = ("attitude", "timing")
AT_REST = Persistence()
LARGEST = sys.float_info.max
Key = tuple[str, str]
"""(packet, field)."""
FieldState = Literal["ok", "watch", "warning", "critical", "stale", "never"]
WORDS: dict[State, FieldState] = {
    State.OK: "ok",
    State.WATCH: "watch",
    State.WARNING: "warning",
    State.CRITICAL: "critical",
}
RuleOf = Callable[[str, TelemetryField], Rule]


@dataclass(frozen=True)
class Judgement:
    """Result of checking one sample against limits. ``judged``: False if limits were not applied, because the sample is
    of an iteration that has ended."""

    packet: str
    field: TelemetryField
    value: float
    state: State
    rule: Rule
    judged: bool = True


@dataclass(slots=True)
class _Watched:
    """A field with limits. ``calm``: True if a further sample from ``low`` to ``high`` changes no state, which allows a
    fast path for nearly all samples; NaN and infinities are outside every range. ``unknown``: True if a further NaN
    changes no state."""

    key: Key
    field: TelemetryField
    rule: Rule
    low: float
    high: float
    calm: bool = False
    unknown: bool = False

    @classmethod
    def by(cls, packet: str, field: TelemetryField, rule: Rule) -> _Watched:
        """Create an entry for a field under a rule."""
        lows = [low for _, (low, _) in rule.limits.levels if low is not None]
        highs = [high for _, (_, high) in rule.limits.levels if high is not None]
        bounds = max(lows, default=-LARGEST), min(highs, default=LARGEST)
        return cls((packet, field.name), field, rule, max(bounds[0], -LARGEST), min(bounds[1], LARGEST))


class LimitCheck:
    """Checks packets and stores the persistence state of every field with limits. Thread-safe.

    ``followed``: fields whose judgements are reported even while they are calm, because they have an open alarm.
    ``status``: packet and fields that report whether the sensor's cycle is running.
    """

    def __init__(
        self, dictionary: TelemetryDefinitions, rule: RuleOf, followed: Container[Key], status: Status
    ) -> None:
        self._dictionary, self._rule, self._followed, self._status = dictionary, rule, followed, status
        self._reported: Mapping[str, Value] = {}
        self._runs: dict[Key, Persistence] = {}
        self._samples: dict[Key, State] = {}
        self._unjudged: set[Key] = set()
        self._ignored_iterations: tuple[Any, ...] = ()
        self._watched: dict[str, list[_Watched]] = {}
        self._was_iterating = False
        self._lock = threading.RLock()

    def take(self, packet: Telemetry) -> list[Judgement]:
        """Check each field of a packet that has limits. A field that stays within its limits is reported only if it is
        followed."""
        with self._lock:
            if packet.packet == self._status.packet:
                self._reported = packet.values
                if not packet.values.get(self._status.cycle_running):
                    iteration_at_rest = packet.values.get(self._status.iteration)
                    self._ignored_iterations = (
                        (iteration_at_rest, iteration_at_rest + 1)
                        if isinstance(iteration_at_rest, int)
                        else (iteration_at_rest,)
                    )
            iterating = self._iterating()
            if iterating is not self._was_iterating:
                self._was_iterating = iterating
                self._reset_fast_path()
            watched = self._watched.get(packet.packet)
            if watched is None:
                watched = self._watched[packet.packet] = self._watched_fields(packet.packet)
            values, judgements = packet.values, []
            for watch in watched:
                value: Any = values.get(watch.key[1], math.nan)
                if watch.calm and watch.low <= value <= watch.high:
                    if watch.key in self._followed:
                        judged = iterating or watch.field.page not in ITERATION_PAGES
                        judgements.append(
                            Judgement(packet.packet, watch.field, float(value), State.OK, watch.rule, judged)
                        )
                elif watch.unknown and value != value:
                    continue
                elif (judgement := self._judge(packet, watch, iterating)) is not None:
                    judgements.append(judgement)
        return judgements

    def _watched_fields(self, packet: str) -> list[_Watched]:
        """Return the fields of a packet that have limits, or that still count as out of limits."""
        watched = []
        for field in self._dictionary.packet(packet).values:
            rule, key = self._rule(packet, field), (packet, field.name)
            if rule.limits.any or self.counted(key) is not State.OK:
                watched.append(_Watched.by(packet, field, rule))
            else:
                self._samples.pop(key, None)
        return watched

    def _reset_fast_path(self) -> None:
        """Disable the fast path of all fields until their next sample has been checked."""
        for watched in self._watched.values():
            for watch in watched:
                watch.calm = watch.unknown = False

    def _judge(self, packet: Telemetry, watch: _Watched, iterating: bool) -> Judgement | None:
        key, field, rule = watch.key, watch.field, watch.rule
        watch.calm = watch.unknown = False
        run = self._runs.get(key, AT_REST)
        if not rule.limits.any and run.counted is State.OK:
            self._samples.pop(key, None)
            return None
        value = plain(packet.values.get(field.name))
        if not isinstance(value, int | float):
            self._runs[key] = run.broken()  # NaN means that the device has not measured the value
            self._samples.pop(key, None)
            watch.unknown = True
            return None
        sample = rule.limits.state(float(value))
        self._samples[key] = sample
        if not iterating and field.page in ITERATION_PAGES:
            self._unjudged.add(key)
            self._runs[key] = AT_REST
            watch.calm = sample is State.OK
            return Judgement(packet.packet, field, float(value), State.OK, rule, judged=False)
        self._unjudged.discard(key)
        self._runs[key] = after = run.after(sample, rule.persistence)
        # A further sample in the same range changes no state.
        watch.calm = after is run and run.counted is sample is State.OK and rule.limits.any
        return Judgement(packet.packet, field, float(value), after.counted, rule)

    def _iterating(self) -> bool:
        """True if limits apply to results and timing of iterations: the cycle is running and has produced a result
        since it started. A sensor at rest finds no stars, and the first iteration after a rest can still use the
        previous pointing. The limits always apply if the sensor reports no cycle."""
        if not self._status.cycle_running:
            return True
        if not self._reported.get(self._status.cycle_running):
            return False
        iteration = self._reported.get(self._status.iteration)
        return iteration is None or iteration not in self._ignored_iterations

    def seed(self, key: Key, counted: State) -> None:
        """Restore the state that a field had before a restart."""
        with self._lock:
            self._runs[key] = Persistence(counted)
            self._watched.clear()

    def limits_changed(self, key: str | None) -> None:
        """Reset the persistence of a field ``packet.name`` (None: of all fields) after its limits changed."""
        with self._lock:
            for k, run in self._runs.items():
                if key is None or key == f"{k[0]}.{k[1]}":
                    self._runs[k] = run.broken()
            self._watched.clear()

    def counted(self, key: Key) -> State:
        """Return the state of a field after persistence."""
        with self._lock:
            return self._runs.get(key, Persistence()).counted

    def states(self, key: Key) -> tuple[FieldState, FieldState]:
        """Return the state of a field after persistence, and the state of its latest sample alone. The first state is
        "stale" if the sample is out of limits but belongs to an iteration that has ended. Such a sample neither raises
        an alarm nor confirms a good value."""
        with self._lock:
            sample = self._samples.get(key, State.OK)
            if key in self._unjudged and sample is not State.OK:
                return "stale", WORDS[sample]
            return WORDS[self._runs.get(key, AT_REST).counted], WORDS[sample]

"""The latest value and state of every field, computed from packets and a clock; used live and in replays."""

from __future__ import annotations

import math
import sys
import threading
from collections.abc import Callable, Container
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from gss.device.dictionary import Dictionary, TelemetryField
from gss.device.session_events import Telemetry
from gss.domain.limits import Persistence, State
from gss.operations.clock import after_jump
from gss.operations.telemetry.limit_book import Rule
from gss.operations.telemetry.value_words import plain

ITERATION_PAGES = ("attitude", "timing")
AT_REST = Persistence()
LARGEST = sys.float_info.max
Key = tuple[str, str]
"""(packet, field)."""
RuleOf = Callable[[str, TelemetryField], Rule]


@dataclass(frozen=True)
class FieldValue:
    """Latest value of one field. ``state``: ok, watch, warning or critical after persistence; or stale, or never.
    ``sample_state``: of this sample alone, before persistence; the same words."""

    definition: TelemetryField
    packet: str
    raw: Any
    value: Any
    state: str
    at: datetime | None
    age_s: float | None
    sample_state: str = "never"


@dataclass(frozen=True)
class Judgement:
    """Result of checking one sample against limits. ``judged`` False: its iteration has ended, so limits were not applied."""

    packet: str
    field: TelemetryField
    value: float
    state: State
    rule: Rule
    judged: bool = True


@dataclass(slots=True)
class _Watched:
    """A field with limits. ``calm``: a further sample from ``low`` to ``high`` changes no state, which allows a fast path
    for nearly all samples; NaN and infinities are in no range. ``unknown``: a further NaN changes no state either."""

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


class TelemetryBoard:
    """Keeps the newest packet of each kind and the persistence of every field with limits. Thread-safe."""

    def __init__(self, dictionary: Dictionary, rule: RuleOf) -> None:
        self._dictionary, self._rule = dictionary, rule
        self._latest: dict[str, tuple[datetime, Telemetry]] = {}
        self._runs: dict[Key, Persistence] = {}
        self._samples: dict[Key, State] = {}
        self._unjudged: set[Key] = set()
        self._unfair: tuple[Any, ...] = ()
        self._watched: dict[str, list[_Watched]] = {}
        self._was_iterating = False
        self._lock = threading.RLock()
        self.followed: Callable[[], Container[Key]] = tuple
        """Returns the fields whose judgements are reported even while they are calm."""

    def take(self, packet: Telemetry, at: datetime) -> list[Judgement]:
        """Make a packet the latest of its kind and judge each of its fields with limits. A field that remains within its
        limits is not reported unless it is ``followed``."""
        with self._lock:
            self._latest[packet.packet] = (at, packet)
            if packet.packet == "housekeeping" and not packet.values.get("cycle_running"):
                at_rest = packet.values.get("iteration")
                self._unfair = (at_rest, at_rest + 1) if isinstance(at_rest, int) else (at_rest,)
            iterating = self._iterating()
            if iterating is not self._was_iterating:
                self._was_iterating = iterating
                self._look_again()
            watched = self._watched.get(packet.packet)
            if watched is None:
                watched = self._watched[packet.packet] = self._watch(packet.packet)
            values, followed, found = packet.values, self.followed(), []
            for one in watched:
                value: Any = values.get(one.key[1], math.nan)
                if one.calm and one.low <= value <= one.high:
                    if one.key in followed:
                        judged = iterating or one.field.page not in ITERATION_PAGES
                        found.append(Judgement(packet.packet, one.field, float(value), State.OK, one.rule, judged))
                elif one.unknown and value != value:
                    continue
                elif (judgement := self._judge(packet, one, iterating)) is not None:
                    found.append(judgement)
        return found

    def _watch(self, packet: str) -> list[_Watched]:
        """Return the fields of a packet that have limits or still count as out of limits."""
        watched = []
        for field in self._dictionary.packet(packet).values:
            rule, key = self._rule(packet, field), (packet, field.name)
            if rule.limits.any or self.counted(key) is not State.OK:
                watched.append(_Watched.by(packet, field, rule))
            else:
                self._samples.pop(key, None)
        return watched

    def _look_again(self) -> None:
        """Reset the fast path of all fields until their next sample has been judged."""
        for watched in self._watched.values():
            for one in watched:
                one.calm = one.unknown = False

    def _judge(self, packet: Telemetry, one: _Watched, iterating: bool) -> Judgement | None:
        key, field, rule = one.key, one.field, one.rule
        one.calm = one.unknown = False
        run = self._runs.get(key, AT_REST)
        if not rule.limits.any and run.counted is State.OK:
            self._samples.pop(key, None)
            return None
        value = plain(packet.values.get(field.name))
        if not isinstance(value, int | float):
            self._runs[key] = run.broken()  # sent as NaN: the device has not measured it
            self._samples.pop(key, None)
            one.unknown = True
            return None
        sample = rule.limits.state(float(value))
        self._samples[key] = sample
        if not iterating and field.page in ITERATION_PAGES:
            self._unjudged.add(key)
            self._runs[key] = AT_REST
            one.calm = sample is State.OK
            return Judgement(packet.packet, field, float(value), State.OK, rule, judged=False)
        self._unjudged.discard(key)
        self._runs[key] = after = run.after(sample, rule.persistence)
        # A further sample in the same range changes no state either.
        one.calm = after is run and run.counted is sample is State.OK and rule.limits.any
        return Judgement(packet.packet, field, float(value), after.counted, rule)

    def _iterating(self) -> bool:
        """True if results and timing of iterations are to be judged: the cycle runs and has produced a result since it
        started. A sensor at rest finds no stars, and the first iteration after a rest may still use the previous pointing."""
        housekeeping = self.latest("housekeeping")
        if housekeeping is None or not housekeeping[1].values.get("cycle_running"):
            return False
        iteration = housekeeping[1].values.get("iteration")
        return iteration is None or iteration not in self._unfair

    def seed(self, key: Key, counted: State) -> None:
        """Set the state that counted before a restart."""
        with self._lock:
            self._runs[key] = Persistence(counted)
            self._watched.clear()

    def clock_jumped(self, now: datetime, jump_s: float) -> None:
        """Shift reception times after the clock jumped, so that ages remain unchanged."""
        with self._lock:
            self._latest = {name: (after_jump(at, now, jump_s), packet) for name, (at, packet) in self._latest.items()}

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

    def latest(self, packet: str) -> tuple[datetime, Telemetry] | None:
        """Return (received, packet), the newest of that kind; None before the first."""
        with self._lock:
            return self._latest.get(packet)

    def values(self, now: datetime) -> list[FieldValue]:
        """Return every field with its current state, in the dictionary's order."""
        with self._lock:
            return [
                self._value(field, packet.name, self._latest.get(packet.name), now)
                for packet in self._dictionary.telemetry
                for field in packet.values
            ]

    def _value(
        self, field: TelemetryField, packet: str, found: tuple[datetime, Telemetry] | None, now: datetime
    ) -> FieldValue:
        if found is None:
            return FieldValue(field, packet, None, None, "never", None, None)
        at, telemetry = found
        raw, value = telemetry.raw.get(field.name), plain(telemetry.values.get(field.name))
        age_s = (now - at).total_seconds()
        key = (packet, field.name)
        sample = "never" if value is None else self._samples.get(key, State.OK).value
        if field.stale_after_s and age_s > field.stale_after_s:
            state = "stale"
        elif value is None:
            state = "never"  # sent as NaN: the device has not measured it yet
        elif key in self._unjudged and sample != State.OK:
            state = "stale"  # from an iteration that has ended: neither an alarm nor a good value
        else:
            state = self._runs.get(key, Persistence()).counted.value
        return FieldValue(field, packet, raw, value, state, at, age_s, sample)

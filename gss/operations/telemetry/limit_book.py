"""Active limits: from the dictionary, the selected limit set, or an operator's override. Every change is recorded."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from gss.domain.errors import BadInput, NotFound
from gss.domain.json_object import JsonObject
from gss.domain.limits import PERSISTENCE_MAX, Limits, Range
from gss.instruments.dictionary.definitions import FLOATS, INTEGER_RANGES, TelemetryField
from gss.operations.clock import Now
from gss.operations.events import EventBus
from gss.operations.telemetry.field_definitions import TelemetryDefinitions
from gss.store import choices as store
from gss.store.engine import Database

SET_NAME = "limit_set"
PREFIX = "limits."
LIMITED_TYPES = (*INTEGER_RANGES, *FLOATS, "bool")


@dataclass(frozen=True)
class Rule:
    """Active limits of one field. ``origin``: dictionary, set or operator. ``changed_by``, ``changed`` and ``note`` are
    set only for an operator's override."""

    limits: Limits
    persistence: int
    origin: str = "dictionary"
    changed_by: str = ""
    changed: datetime | None = None
    note: str = ""


class LimitBook:
    """Provides the active rule of each field. An operator's override applies in every limit set until it is removed."""

    def __init__(self, dictionary: TelemetryDefinitions, database: Database, bus: EventBus, now: Now) -> None:
        self._dictionary, self._database, self._bus, self._now = dictionary, database, bus, now
        self._lock = threading.Lock()
        self._chosen: dict[str, Rule] = {}
        self._rules: dict[tuple[str, str], Rule] = {}
        self._set = self.sets[0][0] if self.sets else ""
        self._listeners: list[Callable[[str | None], None]] = []
        self._load()

    def subscribe(self, listener: Callable[[str | None], None]) -> None:
        """Call ``listener`` with ``packet.name`` of each field whose limits change, or with None if all limits
        change."""
        self._listeners.append(listener)

    def definition_changed(self, key: str) -> None:
        """Discard the cached rules and notify the listeners after the definition of a field ``packet.name`` changed."""
        self._rules = {}
        for listener in self._listeners:
            listener(key)

    def _load(self) -> None:
        with self._database.unit_of_work() as session:
            rows = store.read(session, SET_NAME) + store.read(session, PREFIX)
        for row in rows:
            if row.name == SET_NAME and row.value.get("name") in dict(self.sets):
                self._set = row.value["name"]
            elif row.name.startswith(PREFIX):
                self._chosen[row.name.removeprefix(PREFIX)] = _rule(row.value, row.user, row.changed)

    @property
    def sets(self) -> list[tuple[str, str]]:
        """Tuples (name, note) of the limit sets in the dictionary."""
        return [(s.name, s.note) for s in self._dictionary.limit_sets]

    @property
    def chosen(self) -> str:
        """Name of the active limit set."""
        return self._set

    def rule(self, packet: str, field: TelemetryField) -> Rule:
        """Return the active rule of a field."""
        rules, key = self._rules, (packet, field.name)
        rule = rules.get(key)
        # Every change replaces this cache, so a rule computed before the change cannot enter the new cache.
        if rule is None:
            rule = rules[key] = self._chosen.get(f"{packet}.{field.name}") or self.given(field)
        return rule

    def given(self, field: TelemetryField) -> Rule:
        """Return the rule without an operator's override."""
        of_set = field.sets.get(self._set)
        if of_set is not None:
            return Rule(of_set, field.persistence, "set")
        return Rule(field.limits, field.persistence)

    def choose(self, name: str, *, user: str, note: str = "") -> None:
        """Select another limit set. Raises NotFound."""
        if name not in dict(self.sets):
            raise NotFound("unknown limit set", expected=" | ".join(n for n, _ in self.sets), got=name)
        with self._lock:
            self._write(SET_NAME, {"name": name, "note": note}, user)
            previous, self._set, self._rules = self._set, name, {}
        self._record_event(None, f"{user} activated the limit set {name}; was {previous}", note)

    def override(self, key: str, limits: Limits, persistence: int | None, *, user: str, note: str = "") -> Rule:
        """Set an operator's limits for a field ``packet.name``. Raises BadInput if they are inconsistent."""
        packet, field = self.find(key)
        count = field.persistence if persistence is None else persistence
        if not 1 <= count <= PERSISTENCE_MAX:
            raise BadInput("persistence is out of range", expected=f"1 – {PERSISTENCE_MAX}", got=str(count))
        value = {level.value: list(bounds) for level, bounds in limits.checked().levels}
        with self._lock:
            previous = self.rule(packet, field)
            changed_at = self._write(PREFIX + key, {**value, "persistence": count, "note": note}, user)
            rule = Rule(limits, count, "operator", user, changed_at, note)
            self._chosen[key], self._rules = rule, {}
        self._record_event(key, f"{user} changed the limits of {key} from {words(previous)} to {words(rule)}", note)
        return rule

    def restore(self, key: str, *, user: str) -> Rule:
        """Remove the operator's limits of a field, and return the rule that applies instead."""
        packet, field = self.find(key)
        with self._lock:
            with self._database.unit_of_work() as session:
                existed = store.forget(session, PREFIX + key)
            self._chosen.pop(key, None)
            self._rules = {}
        rule = self.rule(packet, field)
        if existed:
            self._record_event(key, f"{user} restored the dictionary limits of {key}: {words(rule)}", "")
        return rule

    def find(self, key: str) -> tuple[str, TelemetryField]:
        """Return (packet, field) for a key ``packet.name`` of a field that can have limits. Raises BadInput or
        NotFound."""
        packet, _, name = key.partition(".")
        for field in self._dictionary.packet(packet).values:
            if field.name == name:
                if field.type not in LIMITED_TYPES:
                    raise BadInput("only numbers and yes/no values have limits", got=f"{key}, {field.type}")
                return packet, field
        raise NotFound("unknown telemetry field", expected="packet.name", got=key)

    def fields(self) -> list[tuple[str, TelemetryField]]:
        """Return (packet, field) of every field that can have limits."""
        return [(p.name, f) for p in self._dictionary.telemetry for f in p.values if f.type in LIMITED_TYPES]

    def _write(self, name: str, value: JsonObject, user: str) -> datetime:
        now = self._now()
        with self._database.unit_of_work() as session:
            store.write(session, name, value, now, user)
        return now

    def _record_event(self, key: str | None, text: str, note: str) -> None:
        for listener in self._listeners:
            listener(key)
        self._bus.record("limits", "watch", f"{text}: {note}" if note else text, key=key, limit_set=self._set)
        self._bus.publish("limits", {"set": self._set, "key": key})


def _rule(value: JsonObject, user: str, changed: datetime) -> Rule:
    limits = Limits(*(_range(value.get(level)) for level in ("watch", "warning", "critical")))
    return Rule(limits, int(value.get("persistence", 1)), "operator", user, changed, str(value.get("note", "")))


def _range(pair: Any) -> Range:
    low, high = pair or (None, None)
    return low, high


def words(rule: Rule) -> str:
    """Return limits as text for the event log: "watch −15 … 45, critical … 65, 3 samples"."""
    parts = [
        f"{level} {'' if low is None else f'{low:g} '}…{'' if high is None else f' {high:g}'}"
        for level, (low, high) in reversed(rule.limits.levels)
        if low is not None or high is not None
    ]
    count = f"{rule.persistence} sample{'s' if rule.persistence > 1 else ''}"
    return ", ".join([*parts, count]) if parts else "no limits"

"""Telemetry: the latest value of everything with its state, and the archive."""

from __future__ import annotations

import math
import threading
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from gss.device.dictionary import Dictionary, TelemetryField
from gss.device.session_events import SessionEvent, Telemetry
from gss.domain.errors import BadInput, NotFound
from gss.domain.limits import State
from gss.operations.clock import Now
from gss.operations.events import EventBus
from gss.store import telemetry as store
from gss.store.engine import Database
from gss.store.models import TelemetryPacket

ITERATION_PAGES = ("attitude", "timing")
STATE_WORDS = {State.OK: "ok", State.WATCH: "watch", State.WARNING: "warning", State.CRITICAL: "critical"}


@dataclass(frozen=True)
class FieldValue:
    """Latest value of one field. ``state``: ok, watch, warning, critical, stale, never."""

    definition: TelemetryField
    packet: str
    raw: Any
    value: Any
    state: str
    at: datetime | None
    age_s: float | None


class TelemetryService:
    """Keeps the newest packet of each kind, stores all of them, and answers for spans of the past."""

    def __init__(self, dictionary: Dictionary, database: Database, bus: EventBus, now: Now) -> None:
        self._dictionary, self._database, self._bus, self._now = dictionary, database, bus, now
        self._latest: dict[str, tuple[datetime, Telemetry]] = {}
        self._lock = threading.Lock()
        self.contact_id: int | None = None

    def handle(self, events: Sequence[SessionEvent]) -> None:
        """Store the telemetry among these events in one transaction, then make it the latest."""
        packets = [event for event in events if isinstance(event, Telemetry)]
        if not packets:
            return
        at = self._now()
        with self._database.unit_of_work() as session:
            store.add_batch(session, [self._row(packet, at) for packet in packets])
        with self._lock:
            for packet in packets:
                self._latest[packet.packet] = (at, packet)
        for packet in packets:
            if packet.packet == "timing":
                self._bus.publish("cycle", (at, dict(packet.values)))

    def _row(self, packet: Telemetry, at: datetime) -> TelemetryPacket:
        values = {name: plain(value) for name, value in packet.values.items()}
        lists = {
            name: [{k: plain(v) for k, v in item.items()} for item in items] for name, items in packet.lists.items()
        }
        return TelemetryPacket(
            contact_id=self.contact_id,
            packet=packet.packet,
            received=at,
            device_time_s=packet.device_time_s,
            request_id=packet.request_id,
            values={**values, **lists},
        )

    def latest_packet(self, name: str) -> Telemetry | None:
        """The newest packet of that kind, None before the first."""
        with self._lock:
            found = self._latest.get(name)
        return found[1] if found else None

    def values(self) -> list[FieldValue]:
        """Every field of the dictionary with its state now, housekeeping first."""
        with self._lock:
            latest = dict(self._latest)
        now = self._now()
        return [
            self._value(field, packet.name, latest.get(packet.name), now)
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
        if field.stale_after_s and age_s > field.stale_after_s:
            state = "stale"
        elif value is None:
            state = "never"  # sent as not-a-number: the device has not measured it yet
        elif isinstance(value, int | float):
            state = STATE_WORDS[field.limits.state(float(value))]
            if state != "ok" and not self._limits_hold(field):
                state = "stale"  # from an iteration that is over: neither an alarm nor a good value
        else:
            state = "ok"
        return FieldValue(field, packet, raw, value, state, at, age_s)

    def _limits_hold(self, field: TelemetryField) -> bool:
        """Results and timing of iterations are judged only while the cycle runs: a sensor at rest finds no stars."""
        if field.page not in ITERATION_PAGES:
            return True
        housekeeping = self.latest_packet("housekeeping")
        return housekeeping is not None and bool(housekeeping.values.get("cycle_running"))

    def field(self, name: str) -> tuple[str, TelemetryField]:
        """(packet, definition) of a field; housekeeping wins where two packets share the name."""
        for packet in self._dictionary.telemetry:
            for field in packet.values:
                if field.name == name:
                    return packet.name, field
        raise NotFound("unknown telemetry field", got=name, hint="see the dictionary")

    def history(
        self, names: Sequence[str], start: datetime, end: datetime, points: int
    ) -> list[tuple[TelemetryField, list[float], list[float | None]]]:
        """(definition, Unix seconds, values) of each field over a span, at most ``points`` of them."""
        if end <= start:
            raise BadInput("the span is empty", expected="a start before the end", got=f"{start} … {end}")
        by_packet: dict[str, list[TelemetryField]] = {}
        for name in names:
            packet, field = self.field(name)
            by_packet.setdefault(packet, []).append(field)
        series = []
        with self._database.unit_of_work() as session:
            for packet, fields in by_packet.items():
                rows = store.span(session, packet, [field.name for field in fields], start, end)
                t = [row[0].timestamp() for row in rows]
                for k, field in enumerate(fields):
                    series.append((field, *thin(t, [row[1][k] for row in rows], points)))
        return series

    def cycles(self, limit: int) -> list[tuple[datetime, Mapping[str, Any]]]:
        """(received, values) of the newest iterations' timing."""
        with self._database.unit_of_work() as session:
            return [(row.received, row.values) for row in store.newest(session, "timing", limit)]


def plain(value: Any) -> Any:
    """A value as JSON can hold it: bytes in hex, not-a-number and infinities as None."""
    if isinstance(value, bytes):
        return value.hex()
    return None if isinstance(value, float) and not math.isfinite(value) else value


def thin(t: list[float], y: list[float | None], points: int) -> tuple[list[float], list[float | None]]:
    """At most ``points`` samples that keep the smallest and the largest value of each bin, so that no spike is lost."""
    if len(t) <= points:
        return t, y
    bins = max(1, points // 2)
    step = len(t) / bins
    keep: list[int] = []
    for b in range(bins):
        index = range(int(b * step), int((b + 1) * step))
        known = [i for i in index if y[i] is not None]
        if known:
            low, high = min(known, key=lambda i: y[i] or 0.0), max(known, key=lambda i: y[i] or 0.0)
            keep += sorted({low, high})
    return [t[i] for i in keep], [y[i] for i in keep]

"""Telemetry service: stores received packets, checks them against limits, and keeps the latest values."""

from __future__ import annotations

import logging
import math
import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Any

from gss.device.protocol.packet import Arrival
from gss.device.session_events import Telemetry
from gss.domain.errors import BadInput, StoreDown
from gss.instruments.dictionary.definitions import Dictionary, TelemetryField, Values
from gss.instruments.telemetry_roles import Status
from gss.operations.clock import Now, after_jump
from gss.operations.events import EventBus
from gss.operations.line.line_events import LineBatch, ServiceEvent
from gss.operations.telemetry.archive import Archive
from gss.operations.telemetry.derived import PAGE, DerivedParameters
from gss.operations.telemetry.field_definitions import TelemetryDefinitions
from gss.operations.telemetry.limit_book import LimitBook
from gss.operations.telemetry.limit_check import FieldState, Judgement, Key, LimitCheck, RuleOf
from gss.operations.telemetry.rollups import Rollups
from gss.operations.telemetry.value_format import Kind, as_number, formatted, kind, plain, plain_values, raw_text
from gss.store import telemetry as store
from gss.store.engine import Database
from gss.store.models import Alarm

log = logging.getLogger("gss.telemetry")

TRY_EVERY_S = 5.0
DURABLE_EVERY_S = 1.0
TELEMETRY_STORE = "telemetry"
"""Kind of the events that report whether telemetry is stored."""
UNSTORED, STORED_AGAIN = "telemetry is not stored", "telemetry is stored again"
"""First words of the texts of these events. The check of a contact's record searches for these words."""
OLD_EVERY_S = 60.0


@dataclass(frozen=True, slots=True)
class FieldValue:
    """Latest value of one field as responses and pages show it.

    ``state``: state after persistence and staleness; clients never compute it. ``sample_state``: state of this sample
    alone, before persistence. ``raw_text``: raw value in hexadecimal. ``text``: state as text. ``alarm_id``: open alarm
    of the field.
    """

    name: str
    packet: str
    title: str
    page: str
    kind: Kind
    raw: float | int | None
    raw_text: str
    value: float | int | str | None
    formatted: str
    unit: str
    state: FieldState
    sample_state: FieldState
    text: str
    at: datetime | None
    age_s: float | None
    alarm_id: int | None


@dataclass(frozen=True)
class Judged(ServiceEvent):
    """Judgements of the telemetry in a batch, whether or not the telemetry could be stored."""

    judgements: tuple[Judgement, ...]


class TelemetryBoard:
    """Stores the latest packet of each type and checks it against limits. Thread-safe. ``alarms``: open alarms by
    field. ``status``: see :class:`LimitCheck`."""

    def __init__(
        self, dictionary: TelemetryDefinitions, rule: RuleOf, alarms: Mapping[Key, Alarm], status: Status
    ) -> None:
        self.limits = LimitCheck(dictionary, rule, alarms, status)
        self._dictionary, self._alarms = dictionary, alarms
        self._latest: dict[str, tuple[datetime, Telemetry]] = {}
        self._lock = threading.Lock()

    def take(self, packet: Telemetry, at: datetime) -> list[Judgement]:
        """Store a packet as the latest of its type, and return the judgements of its fields with limits."""
        with self._lock:
            self._latest[packet.packet] = (at, packet)
        return self.limits.take(packet)

    def latest(self, packet: str) -> tuple[datetime, Telemetry] | None:
        """Return (received, packet) of the latest packet of a type; None before the first packet."""
        with self._lock:
            return self._latest.get(packet)

    def clock_jumped(self, now: datetime, jump_s: float) -> None:
        """Shift the reception times after a jump of the clock, so that ages do not change."""
        with self._lock:
            self._latest = {name: (after_jump(at, now, jump_s), packet) for name, (at, packet) in self._latest.items()}

    def values(self, now: datetime) -> list[FieldValue]:
        """Return every field with its current state, in the dictionary's order."""
        with self._lock:
            latest = dict(self._latest)
        return [
            self._value(field, packet.name, latest.get(packet.name), now)
            for packet in self._dictionary.telemetry
            for field in packet.values
        ]

    def _value(
        self, field: TelemetryField, packet: str, received: tuple[datetime, Telemetry] | None, now: datetime
    ) -> FieldValue:
        key = (packet, field.name)
        at, telemetry = received or (None, None)
        sent = None if telemetry is None else telemetry.raw.get(field.name)
        value = None if telemetry is None else plain(telemetry.values.get(field.name))
        age_s = None if at is None else (now - at).total_seconds()
        # NaN means that the device has not measured the value.
        state, sample = self.limits.states(key) if value is not None else ("never", "never")
        text: str = state
        if age_s is not None and field.stale_after_s and age_s > field.stale_after_s:
            state, text = "stale", f"stale {age_s:.0f} s"
        elif state == "stale":  # the sensor still sends the value, but from an iteration that has ended
            text = "cycle stopped"
        alarm = self._alarms.get(key)
        return FieldValue(
            name=field.name,
            packet=packet,
            title=field.title,
            page=field.page,
            kind=kind(field),
            raw=as_number(sent),
            raw_text=raw_text(field, sent),
            value=value if isinstance(value, str) else as_number(value),
            formatted=formatted(value, field.decimals),
            unit=field.unit,
            state=state,
            sample_state=sample,
            text=text,
            at=at,
            age_s=age_s,
            alarm_id=None if alarm is None else alarm.id,
        )


class TelemetryService:
    """Stores all packets, keeps the latest packet of each type, and provides access to stored telemetry.

    ``contact_id`` returns the open contact; ``has_room`` is False while the disk is too full for telemetry. ``status``: see
    :class:`LimitCheck`.
    """

    def __init__(
        self,
        dictionary: Dictionary,
        database: Database,
        bus: EventBus,
        now: Now,
        contact_id: Callable[[], int | None],
        has_room: Callable[[], bool],
        status: Status,
    ) -> None:
        self._contact_id, self._has_room = contact_id, has_room
        self._database, self._bus, self._now = database, bus, now
        self.derived = DerivedParameters(dictionary, database, bus, now)
        self.limits = LimitBook(self.derived, database, bus, now)
        self.open_alarms: dict[Key, Alarm] = {}
        """Open alarms by field or condition, maintained by ``AlarmService``."""
        self.board = TelemetryBoard(self.derived, self.limits.rule, self.open_alarms, status)
        self.rollups = Rollups(self.derived, database, now)
        self.archive = Archive(self.derived, database, self.rollups)
        self.limits.subscribe(self.board.limits.limits_changed)
        self.derived.subscribe(self.limits.definition_changed)
        self.unstored = 0
        """Number of packets that could not be stored since the server started."""
        self.store_fails = ""
        """Reason why packets are currently not stored; "" if they are stored."""
        self.old = 0
        """Number of packets that were delayed or repeated on the line since the server started."""
        self._old_recorded, self._old_due_s = 0, 0.0
        self._unstored_from = 0
        self._rejected: set[str] = set()
        self._try_at_s = 0.0
        self._durable_due_s = -math.inf

    def handle(self, batch: LineBatch) -> list[Judged]:
        """Check the telemetry of a batch against limits, update the latest values, and store it in one transaction."""
        received = [event for event in batch.events if isinstance(event, Telemetry)]
        if not received:
            return []
        at = batch.at
        self._report_old([p for p in received if p.arrival is not Arrival.CURRENT], batch)
        current = [p for p in received if p.arrival is Arrival.CURRENT]
        judgements, computed = self._take(current, at)
        # A repeated packet was stored when it was first received.
        self._store([*(p for p in received if p.arrival is not Arrival.REPEATED), *computed], batch)
        for packet in current:
            if packet.packet == "timing":
                self._bus.publish("cycle", (at, dict(packet.values)))
        return [Judged(tuple(judgements))]

    def _take(self, current: Sequence[Telemetry], at: datetime) -> tuple[list[Judgement], list[Telemetry]]:
        """Check packets and the derived parameters that depend on them, and store them as the latest. Return the
        judgements and the derived packets."""
        judgements: list[Judgement] = []
        computed: list[Telemetry] = []
        for packet in current:
            judgements += self.board.take(packet, at)
            for derived in self.derived.computed(packet, at, self.newest_values):
                judgements += self.board.take(derived, at)
                computed.append(derived)
        return judgements, computed

    def newest_values(self, packet: str) -> tuple[datetime, Values] | None:
        """Return (received, values) of the latest packet of a type; None before the first packet."""
        latest = self.board.latest(packet)
        return None if latest is None else (latest[0], latest[1].values)

    def _report_old(self, packets: Sequence[Telemetry], batch: LineBatch) -> None:
        """Count packets that are older than the latest, and record an event at most every ``OLD_EVERY_S`` seconds."""
        self.old += len(packets)
        if self.old == self._old_recorded or batch.at_s < self._old_due_s:
            return
        number, self._old_recorded, self._old_due_s = self.old - self._old_recorded, self.old, batch.at_s + OLD_EVERY_S
        newest = (
            f", the last one {packets[-1].packet} of device time {packets[-1].device_time_s:.3f} s" if packets else ""
        )
        self._record_event(
            "warning",
            f"{number} telemetry packets older than the latest were received{newest}: delayed, repeated or replayed on the line. "
            "They are not shown as current values.",
        )

    def _store(self, packets: Sequence[Telemetry], batch: LineBatch) -> None:
        """Store all packets or none. A packet that the database rejects is lost, and the others are stored. Limits are always
        checked, because alarms must not depend on the disk. While the store is down, only one attempt is made per
        ``TRY_EVERY_S``, because each attempt can block for seconds."""
        if not packets:
            return
        cause = "" if self._has_room() else "the disk is full"
        if not cause and self.store_fails and batch.at_s < self._try_at_s:
            cause = self.store_fails
        elif not cause:
            try:
                with self._database.unit_of_work(durable=self._is_durable(batch)) as session:
                    store.add_many(session, [self._row(packet, batch.at) for packet in packets])
                    self.rollups.wrote(session, [packet.packet for packet in packets], batch.at)
            except BadInput as error:
                if len(packets) == 1:
                    self._lose(packets[0], error)
                else:
                    for packet in packets:
                        self._store([packet], batch)
                return
            except StoreDown as error:
                cause, self._try_at_s = str(error), batch.at_s + TRY_EVERY_S
        before, self.store_fails = self.store_fails, cause
        if cause and not before:
            self._unstored_from = self.unstored
            self._record_event("critical", f"{UNSTORED}, only captured: {cause}")
        elif before and not cause:
            lost = self.unstored - self._unstored_from
            self._record_event("watch", f"{STORED_AGAIN}; {lost} earlier packets are in the raw capture only")
        if cause:
            self.unstored += len(packets)

    def _lose(self, packet: Telemetry, error: BadInput) -> None:
        """Count a packet that the database rejects. An event states the first one of each name."""
        self.unstored += 1
        if packet.packet not in self._rejected:
            self._rejected.add(packet.packet)
            self._record_event("warning", f"a packet {packet.packet} is in the raw capture only: {error}")

    def _is_durable(self, batch: LineBatch) -> bool:
        """True once per ``DURABLE_EVERY_S``. A wait for the disk in every batch would take longer than the commits
        themselves."""
        if batch.at_s < self._durable_due_s:
            return False
        self._durable_due_s = batch.at_s + DURABLE_EVERY_S
        return True

    def _record_event(self, severity: str, text: str) -> None:
        try:
            self._bus.record(TELEMETRY_STORE, severity, text)
        except StoreDown:
            log.exception("not recorded: %s", text)

    def _row(self, packet: Telemetry, at: datetime) -> dict[str, object]:
        return {
            "contact_id": self._contact_id(),
            "packet": packet.packet,
            "received": at,
            "device_time_s": packet.device_time_s,
            "request_id": packet.request_id,
            "values": stored_values(packet),
        }

    def latest_packet(self, name: str) -> Telemetry | None:
        """Return the latest packet of a type; None before the first packet."""
        latest = self.board.latest(name)
        return latest[1] if latest else None

    def values(self) -> list[FieldValue]:
        """Return every field of the dictionary and every derived parameter with its current state, housekeeping
        first."""
        values = self.board.values(self._now())
        return [self._with_reason(value) if value.page == PAGE else value for value in values]

    def _with_reason(self, value: FieldValue) -> FieldValue:
        """Return a field value in which the text states why a derived parameter has no value."""
        reason = self.derived.unknown_reason(value.packet)
        return replace(value, text=f"unknown: {reason}") if reason and value.state == "never" else value

    def tick(self) -> None:
        """Publish the current value of every field, about once a second."""
        self._bus.publish("telemetry", self.values())

    def cycles(self, limit: int) -> list[tuple[datetime, Mapping[str, Any]]]:
        """Return (received, values) of the latest timing packets."""
        with self._database.unit_of_work() as session:
            return [(row.received, row.values) for row in store.newest(session, "timing", limit)]


def stored_values(packet: Telemetry) -> dict[str, object]:
    """Return the values of a packet for its row: engineering values by name, lists by their names."""
    stored = plain_values(packet.values)
    for name, items in packet.lists.items():
        stored[name] = [plain_values(item) for item in items]
    return stored

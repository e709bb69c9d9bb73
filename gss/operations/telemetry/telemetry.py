"""Telemetry: what comes is stored, judged and made the latest."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from datetime import datetime
from typing import Any

from gss.device.dictionary import Dictionary
from gss.device.session_events import SessionEvent, Telemetry
from gss.operations.clock import Now
from gss.operations.events import EventBus
from gss.operations.telemetry.archive import Archive
from gss.operations.telemetry.limit_book import LimitBook
from gss.operations.telemetry.telemetry_board import FieldValue, Judgement, TelemetryBoard
from gss.operations.telemetry.value_words import plain
from gss.store import telemetry as store
from gss.store.engine import Database
from gss.store.models import TelemetryPacket

__all__ = ["FieldValue", "TelemetryService", "plain"]


class TelemetryService:
    """Keeps the newest packet of each kind, stores all of them, and answers for spans of the past.

    ``contact``: asks which contact is open. ``judged_hooks`` get the judgements of each batch after it is stored.
    """

    def __init__(self, dictionary: Dictionary, database: Database, bus: EventBus, now: Now) -> None:
        self._database, self._bus, self._now = database, bus, now
        self.limits = LimitBook(dictionary, database, bus, now)
        self.board = TelemetryBoard(dictionary, self.limits.rule)
        self.archive = Archive(dictionary, database)
        self.limits.changed_hooks.append(self.board.limits_changed)
        self.judged_hooks: list[Callable[[Sequence[Judgement]], None]] = []
        self.contact: Callable[[], int | None] = lambda: None

    def handle(self, events: Sequence[SessionEvent]) -> None:
        """Store the telemetry among these events in one transaction, then judge it and make it the latest."""
        packets = [event for event in events if isinstance(event, Telemetry)]
        if not packets:
            return
        at = self._now()
        with self._database.unit_of_work() as session:
            store.add_batch(session, [self._row(packet, at) for packet in packets])
        judgements = [judgement for packet in packets for judgement in self.board.take(packet, at)]
        for packet in packets:
            if packet.packet == "timing":
                self._bus.publish("cycle", (at, dict(packet.values)))
        for hook in self.judged_hooks:
            hook(judgements)

    def _row(self, packet: Telemetry, at: datetime) -> TelemetryPacket:
        return TelemetryPacket(
            contact_id=self.contact(),
            packet=packet.packet,
            received=at,
            device_time_s=packet.device_time_s,
            request_id=packet.request_id,
            values=stored_values(packet),
        )

    def latest_packet(self, name: str) -> Telemetry | None:
        """The newest packet of that kind, None before the first."""
        found = self.board.latest(name)
        return found[1] if found else None

    def values(self) -> list[FieldValue]:
        """Every field of the dictionary with its state now, housekeeping first."""
        return self.board.values(self._now())

    def cycles(self, limit: int) -> list[tuple[datetime, Mapping[str, Any]]]:
        """(received, values) of the newest iterations' timing."""
        with self._database.unit_of_work() as session:
            return [(row.received, row.values) for row in store.newest(session, "timing", limit)]


def stored_values(packet: Telemetry) -> dict[str, Any]:
    """A packet as its row keeps it: engineering values by name, each list under its name."""
    values = {name: plain(value) for name, value in packet.values.items()}
    lists = {name: [{k: plain(v) for k, v in item.items()} for item in items] for name, items in packet.lists.items()}
    return {**values, **lists}

"""Telemetry: received packets are stored, judged against limits, and kept as latest values."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from typing import Any

from gss.device.dictionary import Dictionary
from gss.device.session_events import Telemetry
from gss.domain.errors import StoreDown
from gss.operations.clock import Now
from gss.operations.events import EventBus
from gss.operations.line.line_events import LineBatch, ServiceEvent
from gss.operations.telemetry.archive import Archive
from gss.operations.telemetry.limit_book import LimitBook
from gss.operations.telemetry.rollups import Rollups
from gss.operations.telemetry.telemetry_board import FieldValue, Judgement, TelemetryBoard
from gss.operations.telemetry.value_words import plain, plain_values
from gss.store import telemetry as store
from gss.store.engine import Database

log = logging.getLogger("gss.telemetry")
__all__ = ["FieldValue", "TelemetryService", "plain"]


TRY_EVERY_S = 5.0


@dataclass(frozen=True)
class Judged(ServiceEvent):
    """Judgements of the telemetry of a batch, whether or not the store could take it."""

    judgements: tuple[Judgement, ...]


class TelemetryService:
    """Stores all packets, keeps the newest of each kind, and gives access to past telemetry.

    ``contact_id`` returns the open contact; ``has_room`` is False while the disk is too full for telemetry.
    """

    def __init__(
        self,
        dictionary: Dictionary,
        database: Database,
        bus: EventBus,
        now: Now,
        contact_id: Callable[[], int | None],
        has_room: Callable[[], bool],
    ) -> None:
        self._contact_id, self._has_room = contact_id, has_room
        self._database, self._bus, self._now = database, bus, now
        self.limits = LimitBook(dictionary, database, bus, now)
        self.board = TelemetryBoard(dictionary, self.limits.rule)
        self.rollups = Rollups(dictionary, database, now)
        self.archive = Archive(dictionary, database, self.rollups)
        self.limits.subscribe(self.board.limits_changed)
        self.unstored = 0
        """Number of packets that could not be stored since the server started."""
        self.store_fails = ""
        """Why packets are currently not stored; "" if they are."""
        self._unstored_from = 0
        self._try_at_s = 0.0

    def handle(self, batch: LineBatch) -> list[Judged]:
        """Store the telemetry of a batch in one transaction, then judge it and update the latest values."""
        packets = [event for event in batch.events if isinstance(event, Telemetry)]
        if not packets:
            return []
        at = batch.at
        judgements = [judgement for packet in packets for judgement in self.board.take(packet, at)]
        self._store(packets, batch)
        for packet in packets:
            if packet.packet == "timing":
                self._bus.publish("cycle", (at, dict(packet.values)))
        return [Judged(tuple(judgements))]

    def _store(self, packets: Sequence[Telemetry], batch: LineBatch) -> None:
        """Store all packets or none. Limits are checked before and in any case: an alarm must not depend on the disk. While the
        store is down it is tried every ``TRY_EVERY_S`` only, because each try may wait for seconds."""
        cause = "" if self._has_room() else "the disk is full"
        if not cause and self.store_fails and batch.at_s < self._try_at_s:
            cause = self.store_fails
        elif not cause:
            try:
                with self._database.unit_of_work() as session:
                    store.add_many(session, [self._row(packet, batch.at) for packet in packets])
                    self.rollups.wrote(session, [packet.packet for packet in packets], batch.at)
            except StoreDown as error:
                cause, self._try_at_s = str(error), batch.at_s + TRY_EVERY_S
        before, self.store_fails = self.store_fails, cause
        if cause and not before:
            self._unstored_from = self.unstored
            self._say("critical", f"telemetry is not stored, the raw capture has it: {cause}")
        elif before and not cause:
            lost = self.unstored - self._unstored_from
            self._say("watch", f"telemetry is stored again; {lost} packets of before are in the raw capture only")
        if cause:
            self.unstored += len(packets)

    def _say(self, severity: str, text: str) -> None:
        try:
            self._bus.record("telemetry", severity, text)
        except StoreDown:
            log.exception("not recorded: %s", text)

    def _row(self, packet: Telemetry, at: datetime) -> dict[str, Any]:
        return {
            "contact_id": self._contact_id(),
            "packet": packet.packet,
            "received": at,
            "device_time_s": packet.device_time_s,
            "request_id": packet.request_id,
            "values": stored_values(packet),
        }

    def latest_packet(self, name: str) -> Telemetry | None:
        """Return the newest packet of that kind; None before the first."""
        found = self.board.latest(name)
        return found[1] if found else None

    def values(self) -> list[FieldValue]:
        """Return every field of the dictionary with its current state, housekeeping first."""
        return self.board.values(self._now())

    def cycles(self, limit: int) -> list[tuple[datetime, Mapping[str, Any]]]:
        """Return (received, values) of the newest timing packets."""
        with self._database.unit_of_work() as session:
            return [(row.received, row.values) for row in store.newest(session, "timing", limit)]


def stored_values(packet: Telemetry) -> dict[str, Any]:
    """Return a packet's values for its row: engineering values by name, each list under its name."""
    stored = plain_values(packet.values)
    for name, items in packet.lists.items():
        stored[name] = [plain_values(item) for item in items]
    return stored

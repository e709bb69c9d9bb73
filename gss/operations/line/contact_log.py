"""Stores contacts and the devices that answered, from the link's events. Runs on a thread that may wait for the database."""

from __future__ import annotations

import logging
from dataclasses import fields, replace

from gss.device.session_events import DirectionCounters, HelloReceived, LinkCounters
from gss.domain.errors import GssError, StoreDown
from gss.operations.clock import Now
from gss.operations.events import EventBus
from gss.operations.line.line_capture import LineCapture
from gss.operations.line.line_events import LineBatch, LineClosed, LineOpened, LinkFault
from gss.store import devices as store
from gss.store.engine import Database

log = logging.getLogger("gss.link")
BYTES_EVERY_S = 5.0


class ContactLog:
    """The state of the open contact as the services see it. It changes in the order of the link's events."""

    def __init__(self, database: Database, bus: EventBus, now: Now, capture: LineCapture) -> None:
        self._database, self._bus, self._now, self._capture = database, bus, now, capture
        self.is_open = False
        """True between the handling of LineOpened and of LineClosed."""
        self.contact_id: int | None = None
        """None without a contact, and until the contact's row has been stored."""
        self.hello: HelloReceived | None = None
        """The device at the other end; None until it has answered in this contact."""
        self.last_hello: HelloReceived | None = None
        """The device that answered last; kept when the line is lost."""
        self.dictionary_acknowledged = False
        self.counted_from = LinkCounters(DirectionCounters(), DirectionCounters(), None)
        self._unstored: LineOpened | None = None
        self._next_count_s = 0.0

    def start(self) -> int:
        """Close the contacts that a crash left open. Returns the number for the next contact."""
        with self._database.unit_of_work() as session:
            store.close_left_open(session, self._now())
            return store.last_contact_id(session) + 1

    def forget_device(self) -> None:
        """Forget the device that answered last, because another port was chosen."""
        self.last_hello = None

    def acknowledge_dictionary(self) -> None:
        """Record that an operator accepted the dictionary mismatch; valid until the next device answers."""
        self.dictionary_acknowledged = True

    def counters_of(self, now: LinkCounters) -> LinkCounters:
        """Return ``now`` minus the counters at the start of this contact."""
        then = self.counted_from
        return LinkCounters(_less(now.sent, then.sent), _less(now.received, then.received), now.last_good_s)

    def handle(self, batch: LineBatch) -> None:
        """Keep the contact's row up to date."""
        for event in batch.events:
            if isinstance(event, LineOpened):
                self._opened(event)
            elif isinstance(event, LineClosed):
                self._closed(event)
            elif isinstance(event, HelloReceived):
                self._greeted(event)
            elif isinstance(event, LinkFault):
                self.report(event.severity, event.text)
            elif isinstance(event, LinkCounters) and batch.at_s >= self._next_count_s:
                self._next_count_s = batch.at_s + BYTES_EVERY_S
                self._count(event)

    def report(self, severity: str, text: str) -> None:
        """Record an event of the link; log it if the store is unavailable."""
        try:
            self._bus.record("link", severity, text, contact_id=self.contact_id)
        except GssError:
            log.exception("not recorded: %s", text)

    def _opened(self, event: LineOpened) -> None:
        self.counted_from, self._next_count_s = event.counters, 0.0
        self._unstored, self.contact_id = event, None
        try:
            self._store_contact()
        finally:
            self.is_open = True
        self.report("ok", f"line open on {event.url}")

    def _store_contact(self) -> None:
        """Store the contact's row. If the store is down, this is tried again with the next counters."""
        event = self._unstored
        if event is None:
            return
        try:
            with self._database.unit_of_work() as session:
                store.open_contact(session, event.url, self._now(), event.capture, contact_id=event.contact_id)
        except StoreDown as error:
            log.warning("the contact is not stored yet: %s", error)
            return
        self.contact_id, self._unstored = event.contact_id, None
        if self.hello is not None:
            self._store_device(self.hello)

    def _closed(self, event: LineClosed) -> None:
        try:
            self._store_contact()
            self._count(event.counters, ended=True)
        finally:
            contact_id, self.contact_id, self.hello, self._unstored = self.contact_id, None, None, None
            self.is_open = False
        self._bus.record("link", "watch", f"line closed: {event.cause}", contact_id=contact_id)

    def _greeted(self, hello: HelloReceived) -> None:
        self.hello = self.last_hello = hello
        self.dictionary_acknowledged = False
        self._store_device(hello)
        match = "dictionary matches" if hello.dictionary_match else "DICTIONARY DIFFERS, commanding is blocked"
        severity = "ok" if hello.dictionary_match else "warning"
        self.report(severity, f"{_name_of(hello)} answered, firmware {hello.firmware}, {match}")

    def _store_device(self, hello: HelloReceived) -> None:
        try:
            with self._database.unit_of_work() as session:
                device = store.remember(
                    session,
                    self._now(),
                    name=_name_of(hello),
                    profile=hello.profile,
                    firmware=hello.firmware,
                    simulated=hello.simulated,
                    dictionary_hash=hello.dictionary_hash,
                )
                if self.contact_id is not None:
                    store.update_contact(session, self.contact_id, device_id=device.id)
        except StoreDown as error:
            log.warning("the device that answered is not stored: %s", error)

    def _count(self, counters: LinkCounters, *, ended: bool = False) -> None:
        """Store the contact's byte counts. If the store is down, a later call stores them."""
        own = self.counters_of(counters)
        try:
            self._store_contact()
            if self.contact_id is None:
                return
            with self._database.unit_of_work() as session:
                store.update_contact(
                    session,
                    self.contact_id,
                    rx_bytes=own.received.bytes,
                    tx_bytes=own.sent.bytes,
                    captures=self._capture.files_of(self.contact_id),
                    ended=self._now() if ended else None,
                )
        except StoreDown as error:
            log.warning("the contact's bytes were not stored: %s", error)


def _name_of(hello: HelloReceived) -> str:
    return hello.serial or f"{hello.profile} {hello.device_model}"


def _less(now: DirectionCounters, then: DirectionCounters) -> DirectionCounters:
    return replace(now, **{f.name: getattr(now, f.name) - getattr(then, f.name) for f in fields(DirectionCounters)})

"""Log of contacts and of the devices that answered, from the link's events. It runs in a thread that can wait for the
database."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import fields, replace
from datetime import datetime
from functools import partial

from gss.device.session_events import DirectionCounters, HelloReceived, LinkCounters
from gss.domain.errors import GssError, StoreDown
from gss.operations.clock import Now
from gss.operations.events import EventBus
from gss.operations.line.deferred_writes import DeferredWrites
from gss.operations.line.line_capture import LineCapture
from gss.operations.line.line_events import LineBatch, LineClosed, LineOpened, LinkFault
from gss.store import devices as store
from gss.store.engine import Database

log = logging.getLogger("gss.link")
BYTES_EVERY_S = 5.0


class ContactLog:
    """State of the open contact for the services. It changes in the order of the link's events.

    ``version_of``: returns the version of the instrument that a device reports, None if the instrument is unknown.
    ``own_simulator``: address of the simulator that this server started, empty if there is none. The device at this address is
    marked as simulated, because not every protocol reports this.
    """

    def __init__(
        self,
        database: Database,
        bus: EventBus,
        now: Now,
        capture: LineCapture,
        version_of: Callable[[str], str | None],
        own_simulator: str,
    ) -> None:
        self._version_of, self._own_simulator = version_of, own_simulator
        self._url = ""
        self._database, self._bus, self._now, self._capture = database, bus, now, capture
        self.is_open = False
        """True between the handling of LineOpened and of LineClosed."""
        self.contact_id: int | None = None
        """Id of the open contact. None without a contact and until the row of the contact is stored."""
        self.hello: HelloReceived | None = None
        """The connected device, None until it has answered in this contact."""
        self.last_hello: HelloReceived | None = None
        """The last device that answered. It remains set after the line is lost."""
        self._acknowledged_hash = ""
        self.counted_from = LinkCounters(DirectionCounters(), DirectionCounters(), None)
        self._reserved_id = 0
        self._writes = DeferredWrites()
        self._next_count_s = 0.0

    def start(self) -> int:
        """Close the contacts that are still open after a crash. Return the id for the next contact."""
        with self._database.unit_of_work() as session:
            store.close_left_open(session, self._now())
            return store.last_contact_id(session) + 1

    def forget_device(self) -> None:
        """Clear ``last_hello``, because another port was selected."""
        self.last_hello = None

    def acknowledge_dictionary(self, device_hash: str) -> None:
        """Record that an operator accepted the device's dictionary. This is valid until another dictionary answers, as in the
        session."""
        self._acknowledged_hash = device_hash

    @property
    def dictionary_acknowledged(self) -> bool:
        """True if an operator accepted the dictionary of the last device that answered."""
        return self._acknowledged_hash != ""

    def counters_of(self, now: LinkCounters) -> LinkCounters:
        """Return the counts of this contact: ``now`` minus the counters at the start of the contact."""
        start = self.counted_from
        return LinkCounters(
            _difference(now.sent, start.sent), _difference(now.received, start.received), now.last_good_s
        )

    def handle(self, batch: LineBatch) -> None:
        """Update the contact and its row from the link's events."""
        for event in batch.events:
            if isinstance(event, LineOpened):
                self._opened(event, batch.at)
            elif isinstance(event, LineClosed):
                self._closed(event, batch.at)
            elif isinstance(event, HelloReceived):
                self._greeted(event, batch.at)
            elif isinstance(event, LinkFault):
                self.report(event.severity, event.text)
            elif isinstance(event, LinkCounters) and batch.at_s >= self._next_count_s:
                self._next_count_s = batch.at_s + BYTES_EVERY_S
                self._count(event)

    def report(self, severity: str, text: str) -> None:
        """Record a link event for the open contact. If the store is down, write the event to the log."""
        self.report_of(self.contact_id, severity, text)

    def report_of(self, contact_id: int | None, severity: str, text: str) -> None:
        """Record a link event for a given contact. If the store is down, write the event to the log."""
        try:
            self._bus.record("link", severity, text, contact_id=contact_id)
        except GssError:
            log.exception("not recorded: %s", text)

    def _opened(self, event: LineOpened, at: datetime) -> None:
        self._next_count_s = 0.0
        if not event.continued:
            self.counted_from = event.counters
        self._reserved_id, self.contact_id, self._url = event.contact_id, None, event.url
        self._writes.add(partial(self._store_contact, event, at))
        self._writes.run()
        self.is_open = True
        again = f" again, contact {event.contact_id} continues" if event.continued else ""
        self.report("ok", f"Line open on {event.url}{again}")

    def _store_contact(self, event: LineOpened, at: datetime) -> None:
        with self._database.unit_of_work() as session:
            if event.continued:
                store.reopen_contact(session, event.contact_id)
            else:
                store.open_contact(session, event.url, at, event.capture, contact_id=event.contact_id)
        if event.contact_id == self._reserved_id:
            self.contact_id = event.contact_id

    def _closed(self, event: LineClosed, at: datetime) -> None:
        self._writes.add(partial(self._store_count, self._reserved_id, self.counters_of(event.counters), at))
        self._writes.run()
        contact_id, self.contact_id, self.hello, self._reserved_id = self.contact_id, None, None, 0
        self.is_open = False
        self.report_of(contact_id, "watch", f"{store.LINE_CLOSED}{event.cause}")

    def _greeted(self, hello: HelloReceived, at: datetime) -> None:
        if self._own_simulator and self._url == self._own_simulator:
            hello = replace(hello, simulated=True)
        self.hello = self.last_hello = hello
        if hello.dictionary_hash != self._acknowledged_hash:
            self._acknowledged_hash = ""
        self._writes.add(partial(self._store_device, self._reserved_id, hello, at))
        self._writes.run()
        severity, match = "ok", "dictionary matches"
        if not hello.dictionary_match:
            consequence = "as acknowledged" if self.dictionary_acknowledged else "commanding is blocked"
            severity, match = "warning", f"dictionary differs, {consequence}"
        self.report(severity, f"{hello.unit_name} connected, firmware {hello.firmware}, {match}")

    def _store_device(self, contact_id: int, hello: HelloReceived, at: datetime) -> None:
        with self._database.unit_of_work() as session:
            device = store.remember(
                session,
                at,
                name=hello.unit_name,
                profile=hello.profile,
                firmware=hello.firmware,
                simulated=hello.simulated,
                dictionary_hash=hello.dictionary_hash,
            )
            if contact_id:
                store.update_contact(
                    session,
                    contact_id,
                    device_id=device.id,
                    instrument=hello.profile or None,
                    instrument_version=self._version_of(hello.profile),
                )

    def _store_count(self, contact_id: int, counters: LinkCounters, ended: datetime | None) -> None:
        with self._database.unit_of_work() as session:
            store.update_contact(
                session,
                contact_id,
                rx_bytes=counters.received.bytes,
                tx_bytes=counters.sent.bytes,
                captures=self._capture.files_of(contact_id),
                ended=ended,
            )

    def _count(self, counters: LinkCounters) -> None:
        """Run the deferred writes and store the byte counts of the contact. If the store is down, a later call stores the byte
        counts."""
        self._writes.run()
        if self.contact_id is not None:
            try:
                self._store_count(self.contact_id, self.counters_of(counters), None)
            except StoreDown as error:
                log.warning("the contact's bytes were not stored: %s", error)


def _difference(now: DirectionCounters, start: DirectionCounters) -> DirectionCounters:
    return replace(now, **{f.name: getattr(now, f.name) - getattr(start, f.name) for f in fields(DirectionCounters)})

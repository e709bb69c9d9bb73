"""The one owner of the port: a thread that reads, decodes, writes and tells the other operations what came."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Sequence
from dataclasses import fields
from pathlib import Path

from gss.device.dictionary import Dictionary
from gss.device.session import HostSession
from gss.device.session_events import DirectionCounters, HelloReceived, LinkCounters, SessionEvent
from gss.device.transport import ByteStream, open_stream
from gss.domain.errors import Conflict, GssError, LinkDown, StoreDown
from gss.operations.clock import Monotonic, Now
from gss.operations.events import EventBus
from gss.operations.line.line_capture import LineCapture
from gss.operations.line.raw_capture import RECEIVED, SENT, Retention
from gss.store import devices as store
from gss.store.engine import Database

log = logging.getLogger("gss.link")

READ_BYTES = 65536
READ_WAIT_S = 0.01
RETRY_S = 2.0
REOPEN_S = 0.5
BYTES_EVERY_S = 5.0
STALLED_AFTER_S = 20.0
"""Longer than any write may take; a reader that did not get round for so long hangs."""

Handler = Callable[[Sequence[SessionEvent]], None]


class LinkService:
    """Opens a port, keeps it open, and feeds the host session.

    ``lock`` guards the session: whoever submits holds it until the row of what was submitted is stored, so that no
    report can overtake its row.
    """

    def __init__(
        self,
        dictionary: Dictionary,
        database: Database,
        bus: EventBus,
        captures: Path,
        now: Now,
        monotonic_s: Monotonic,
        framing: str = "cobs",
        retention: Retention | None = None,
    ) -> None:
        self.dictionary, self.framing = dictionary, framing
        self.session = HostSession(dictionary, framing=framing)
        self.lock = threading.RLock()
        self.url = ""
        self.connected = False
        self.reason = "no port has been opened"
        self.contact_id: int | None = None
        self.hello: HelloReceived | None = None
        self.last_hello: HelloReceived | None = None
        """Who was at the other end last; stays when the line is lost."""
        self.dictionary_acknowledged = False
        self.handlers: list[Handler] = []
        self.rounds: list[Callable[[], None]] = []
        """Called by the thread that reads the line each time it gets round, some hundred times a second, also without a line."""
        self._database, self._bus = database, bus
        self._now, self.monotonic_s = now, monotonic_s
        self.capture = LineCapture(captures, retention or Retention(), now, self._complain)
        self._counted_from = self.session.counters
        self._wake = threading.Event()
        self._stopping = False
        self._stream: ByteStream | None = None
        self._round_s = monotonic_s()
        self._reopen = False
        self._thread = threading.Thread(target=self._run, name="link", daemon=True)

    def start(self) -> None:
        """Start the thread; contacts that a crash left open are closed first."""
        with self._database.unit_of_work() as session:
            store.close_left_open(session, self._now())
        self._thread.start()

    def stop(self) -> None:
        """Close the port and end the thread."""
        self._stopping = True
        self.url = ""
        self._wake.set()
        if self._thread.is_alive():
            self._thread.join(timeout=5)

    def open(self, url: str) -> None:
        """Use this port from now on; BadInput, Conflict or LinkDown when it cannot be opened, and then nothing changes."""
        stream = open_stream(url)
        stream.close()
        if url != self.url:
            self.last_hello = None
        self.url, self._reopen = url, True
        self._wake.set()

    def open_later(self, url: str) -> None:
        """Use this port as soon as it exists."""
        self.url, self._reopen = url, True
        self._wake.set()

    def close(self) -> None:
        """Give the port back."""
        self.url, self.reason = "", "closed by the operator"
        self._wake.set()

    def acknowledge_dictionary(self, user: str) -> None:
        """An operator accepts that the device has another dictionary; commanding is possible again, at their risk."""
        if self.hello is None or self.hello.dictionary_match:
            raise Conflict(
                "there is no difference to acknowledge", got="dictionary matches" if self.hello else "no device"
            )
        with self.lock:
            self.session.acknowledge_mismatch()
        self.dictionary_acknowledged = True
        self._bus.record(
            "link", "watch", f"{user} acknowledged that the dictionaries differ", contact_id=self.contact_id
        )

    @property
    def counters(self) -> LinkCounters:
        """Counters since the server started."""
        return self.session.counters

    @property
    def contact_counters(self) -> LinkCounters:
        """Counters since this contact was opened."""
        now, then = self.counters, self._counted_from
        return LinkCounters(_less(now.sent, then.sent), _less(now.received, then.received), now.last_good_s)

    # --- watching the reader ------------------------------------------------------------------------------------

    def alive(self) -> bool:
        """Does the thread that reads the line get round?"""
        return self._thread.is_alive() and self.monotonic_s() - self._round_s < STALLED_AFTER_S

    def watch(self) -> None:
        """The watchdog, called about once a second: a reader that hangs loses its port, which ends the hanging call and opens the
        line anew; one that died is started anew. Both are told."""
        if self._stopping or self.alive() or self._thread.ident is None:
            return
        if not self._thread.is_alive():
            self._complain("the thread that reads the line had ended; it is started anew")
            self._round_s = self.monotonic_s()
            self._thread = threading.Thread(target=self._run, name="link", daemon=True)
            self._thread.start()
            return
        stalled_s, stream = self.monotonic_s() - self._round_s, self._stream
        self._round_s = self.monotonic_s()  # give it the same time again before the next step
        self._complain(f"the thread that reads the line did not get round for {stalled_s:.0f} s; its port is closed")
        if stream is not None:
            stream.close()

    def _run(self) -> None:
        while not self._stopping:
            self._round_s = self.monotonic_s()
            try:
                self._get_round()
                self._once()
            except Exception as error:  # the owner of the port must outlive a full disk or a locked database
                log.exception("the contact failed")
                self.connected, self.reason = False, f"{type(error).__name__}: {error}"
                self._complain(f"the contact was given up: {self.reason}")
                self._pause(RETRY_S)

    def _once(self) -> None:
        """Open the line and keep it for a contact."""
        if not self.url:
            self._pause(0.5)
            return
        url, self._reopen = self.url, False
        try:
            stream = open_stream(url)
        except GssError as error:
            self._could_not_open(str(error))
            self._pause(RETRY_S)
            return
        self._stream = stream
        try:
            self._contact(stream, url)
        except BaseException:  # whatever ended it: the port is free for the next try
            stream.close()
            raise
        finally:
            self._stream = None
        if self.url == url and not self._reopen:
            # The line was lost. A far end that hangs up at once must not make a contact of every moment.
            self._pause(REOPEN_S)

    def _pause(self, seconds: float) -> None:
        self._wake.wait(seconds)
        self._wake.clear()

    def _could_not_open(self, reason: str) -> None:
        """Say it once, not at every try."""
        if reason != self.reason:
            self._bus.record("link", "warning", f"{reason}. Trying again every {RETRY_S:g} s")
        self.reason = reason

    def _contact(self, stream: ByteStream, url: str) -> None:
        with self._database.unit_of_work() as session:
            contact = store.open_contact(session, url, self._now(), "")
            self.contact_id = contact.id
            contact.capture = self.capture.begin(contact.id)
        self._counted_from = self.counters
        self.connected, self.reason = True, ""
        self._bus.record("link", "ok", f"line open on {url}", contact_id=self.contact_id)
        with self.lock:
            self.session.link_up(self.monotonic_s())
        try:
            self._exchange(stream, url)
            cause = self.reason or "the port was changed"
        except LinkDown as error:
            cause = str(error)
        finally:
            stream.close()
        self._end_contact(cause)

    def _exchange(self, stream: ByteStream, url: str) -> None:
        next_count_s = 0.0
        while self.url == url and not self._reopen and not self._stopping:
            self._round_s = self.monotonic_s()
            data = stream.read(READ_BYTES, READ_WAIT_S)
            self.capture.write(RECEIVED, data)
            now_s = self.monotonic_s()
            with self.lock:
                events = list(self.session.feed(data, now_s)) if data else []
                out, more = self.session.poll(now_s)
            if out:
                self.capture.write(SENT, out)
                stream.write(out)
            self._tell([*events, *more])
            self._get_round()
            if now_s > next_count_s:
                next_count_s = now_s + BYTES_EVERY_S
                try:
                    self._count_bytes()
                except StoreDown as error:  # bytes are counted again later; the line goes on without a store
                    log.warning("the contact's bytes were not stored: %s", error)

    def _tell(self, events: Sequence[SessionEvent]) -> None:
        if not events:
            return
        for event in events:
            if isinstance(event, HelloReceived):
                self._met(event)
        for handler in self.handlers:
            self._guarded(handler, events)

    def _get_round(self) -> None:
        for look in self.rounds:
            self._guarded(look)

    def _guarded(self, call: Callable[..., None], *given: Sequence[SessionEvent]) -> None:
        try:
            call(*given)
        except Exception as error:  # one operation's defect must not silence the line: it is told and logged
            log.exception("handler %r failed", call)
            self._complain(f"what came could not be handled: {type(error).__name__}: {error}")

    def _complain(self, text: str) -> None:
        """Tell a failure of our own; if even the record cannot be written, the log has it."""
        try:
            self._bus.record("link", "critical", text, contact_id=self.contact_id)
        except GssError:
            log.exception("not recorded: %s", text)

    def _met(self, hello: HelloReceived) -> None:
        self.hello = self.last_hello = hello
        self.dictionary_acknowledged = False
        name = f"{hello.serial}" if hello.serial else f"{hello.profile} {hello.device_model}"
        with self._database.unit_of_work() as session:
            device = store.remember(
                session,
                self._now(),
                name=name,
                profile=hello.profile,
                firmware=hello.firmware,
                simulated=hello.simulated,
                dictionary_hash=hello.dictionary_hash,
            )
            if self.contact_id is not None:
                store.update_contact(session, self.contact_id, device_id=device.id)
        match = "dictionary matches" if hello.dictionary_match else "DICTIONARY DIFFERS, commanding is blocked"
        severity = "ok" if hello.dictionary_match else "warning"
        self._bus.record(
            "link", severity, f"{name} answered, firmware {hello.firmware}, {match}", contact_id=self.contact_id
        )

    def _end_contact(self, cause: str) -> None:
        self.connected, self.reason = False, cause
        with self.lock:
            events = self.session.link_lost(self.monotonic_s())
        self._tell([*events, self.counters])
        self._count_bytes(ended=True)
        self.capture.end()
        contact_id, self.contact_id, self.hello = self.contact_id, None, None
        self._bus.record("link", "watch", f"line closed: {cause}", contact_id=contact_id)

    def _count_bytes(self, *, ended: bool = False) -> None:
        counters = self.contact_counters
        with self._database.unit_of_work() as session:
            if self.contact_id is not None:
                store.update_contact(
                    session,
                    self.contact_id,
                    rx_bytes=counters.received.bytes,
                    tx_bytes=counters.sent.bytes,
                    captures=self.capture.files,
                    ended=self._now() if ended else None,
                )


def _less(now: DirectionCounters, then: DirectionCounters) -> DirectionCounters:
    return DirectionCounters(*(getattr(now, f.name) - getattr(then, f.name) for f in fields(DirectionCounters)))

"""Link to the device. A thread owns the port, reads, decodes and writes, and publishes events. It never waits for the store."""

from __future__ import annotations

import logging
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from gss.device.driver import Driver
from gss.device.line_address import CAN
from gss.device.session import HostSession
from gss.device.session_events import HelloReceived, LinkCounters
from gss.device.transport import DEFAULT_BAUD, ByteStream, open_stream
from gss.domain.errors import BadInput, Conflict, GssError, LinkDown
from gss.instruments.dictionary.definitions import Dictionary, Value
from gss.instruments.package_files import LinkFile
from gss.instruments.registry import shipped_version
from gss.instruments.roles import Roles
from gss.operations.clock import Monotonic, Now
from gss.operations.events import EventBus
from gss.operations.line.contact_log import ContactLog
from gss.operations.line.dispatcher import LineEventQueue
from gss.operations.line.line_capture import LineCapture
from gss.operations.line.line_events import LineBatch, LineClosed, LineOpened, LinkFault
from gss.operations.line.raw_capture import RECEIVED, SENT, Retention
from gss.operations.line.session_lock import FOREVER, SessionLock
from gss.store.engine import Database

log = logging.getLogger("gss.link")

READ_BYTES = 65536
READ_WAIT_S = 0.01
RETRY_S = 2.0
REOPEN_S = 0.5
REPORT_EVERY_S = 60.0
JOIN_WITHIN_S = 10.0
"""A lost line that is opened again within this time continues the same contact."""

OpenLine = Callable[[str, int], ByteStream]
"""Opens the line at an address with a bit rate. Raises BadInput, Conflict or LinkDown."""


class LinkService:
    """Opens a port, keeps it open, and feeds the host session.

    There are two locks, which must be acquired in this order. ``hold_events`` prevents the services from handling events while a
    row is stored. ``lock`` protects the session; to acquire it raises Conflict if the driver hangs. The line thread acquires only
    ``lock``, so a thread that holds ``lock`` must not wait for the store, a file or the network.

    ``session``: session of the instrument's driver, by default a session of the driver ``gss``. ``rules``: settings of the line.
    The line thread is considered to hang if it has not completed a cycle for ``rules.stalled_after_s``; ``stall`` is then the
    report, otherwise "". ``version_of`` and ``own_simulator``: see :class:`ContactLog`. ``open_line``: replaces the function
    that opens real ports.
    """

    def __init__(
        self,
        dictionary: Dictionary,
        roles: Roles,
        database: Database,
        bus: EventBus,
        captures: Path,
        now: Now,
        monotonic_s: Monotonic,
        events: LineEventQueue,
        session: Driver | None = None,
        retention: Retention | None = None,
        rules: LinkFile | None = None,
        version_of: Callable[[str], str | None] = shipped_version,
        own_simulator: str = "",
        open_line: OpenLine | None = None,
    ) -> None:
        self._rules = rules or LinkFile()
        self.dictionary, self.roles = dictionary, roles
        self.session: Driver = session or HostSession(dictionary, hello_again_s=self._rules.hello_again_s)
        self.lock = SessionLock()
        self.url = ""
        self.line_is_open = False
        """True while bytes can be sent. ``connected`` becomes True later, when the services were notified of the contact."""
        self.reason = "no port has been opened"
        self.events = events
        self._bus = bus
        self._now, self.monotonic_s = now, monotonic_s
        self.capture = LineCapture(captures, retention or Retention(), now, self._fault)
        self.contact = ContactLog(database, bus, now, self.capture, version_of, own_simulator)
        self._next_contact_id = 1
        self._lost_line: tuple[str, float] | None = None
        """Address and time (monotonic) of a line that was lost and not opened again. The next contact can continue it."""
        self._wake = threading.Event()
        self._stopping = False
        self._open_line = open_line
        self._stream: ByteStream | None = None
        self._closed_by_watch: ByteStream | None = None
        self._round_s = monotonic_s()
        self.stall = ""
        self._reopen = False
        self._last_failure: tuple[str, float] = ("", 0.0)
        self._thread = threading.Thread(target=self._run, name="link", daemon=True)

    def start(self) -> None:
        """Close the contacts that are still open after a crash, then start the thread."""
        self._next_contact_id = self.contact.start()
        self._thread.start()

    def stop(self) -> None:
        """Close the port and end the thread."""
        self._stopping = True
        self.url = ""
        self._wake.set()
        if self._thread.is_alive():
            self._thread.join(timeout=5)

    def open(self, url: str) -> None:
        """Switch the link to this port. Raises BadInput, Conflict or LinkDown if the port cannot be opened; the link then
        remains unchanged."""
        stream = self._opened(url)
        stream.close()
        if url != self.url:
            self.contact.forget_device()
        self.open_later(url)

    def open_later(self, url: str) -> None:
        """Switch the link to this port. If the port does not exist, retry until it does."""
        self._lost_line = None
        self.url, self._reopen = url, True
        self._wake.set()

    def close(self) -> None:
        """Close the port."""
        self._lost_line = None
        self.url, self.reason = "", "closed by the operator"
        self._wake.set()

    def acknowledge_dictionary(self, user: str) -> None:
        """Record that the user accepts the device's different dictionary, and enable commanding. Raises Conflict if there is no
        difference."""
        with self.hold_events():  # otherwise another device could be recorded between the two acknowledgements
            hello = self.hello
            if hello is None or hello.dictionary_match:
                raise Conflict("no dictionary difference to acknowledge", got="a match" if hello else "no device")
            with self.lock:
                if self.session.device_dictionary_hash != hello.dictionary_hash:
                    raise Conflict("another device has answered", hint="compare the dictionaries again")
                self.session.acknowledge_mismatch()
            self.contact.acknowledge_dictionary(hello.dictionary_hash)
        self._bus.record(
            "link", "watch", f"{user} acknowledged that the dictionaries differ", contact_id=self.contact_id
        )

    @contextmanager
    def hold_events(self) -> Iterator[None]:
        """Prevent the services from handling events during the block, so that the row of a new command or transfer is stored
        before a report on it is handled."""
        with self.events.hold:
            yield

    def handle(self, batch: LineBatch) -> None:
        """Update the contact. This is the first subscriber of each batch."""
        self.contact.handle(batch)

    def status(self) -> dict[str, Value]:
        """Return the latest status of the sensor: standard quantity to value. Empty before the first status."""
        return self.roles.quantities.status.read(self.session.housekeeping or {})

    @property
    def connected(self) -> bool:
        """True if the port is open and the services were notified of the contact."""
        return self.line_is_open and self.contact.is_open

    @property
    def contact_id(self) -> int | None:
        """Id of the open contact, None if there is none."""
        return self.contact.contact_id

    @property
    def hello(self) -> HelloReceived | None:
        """The connected device, None until it has answered."""
        return self.contact.hello

    @property
    def last_hello(self) -> HelloReceived | None:
        """The last device that answered. It remains set after the line is lost."""
        return self.contact.last_hello

    @property
    def dictionary_acknowledged(self) -> bool:
        """True if an operator accepted that the dictionaries differ."""
        return self.contact.dictionary_acknowledged

    @property
    def counters(self) -> LinkCounters:
        """Counters since the server started."""
        return self.session.counters

    @property
    def contact_counters(self) -> LinkCounters:
        """Counters since this contact was opened."""
        return self.contact.counters_of(self.counters)

    # --- watchdog -------------------------------------------------------------------------------------------------

    def alive(self) -> bool:
        """True if the line thread is making progress."""
        return self._thread.is_alive() and self.monotonic_s() - self._round_s < self._rules.stalled_after_s

    def watch(self) -> None:
        """Watchdog, called about once a second. If the line thread hangs, close its port, which ends the blocked call and
        reopens the line. If the thread has died, restart it. Both cases are reported."""
        if self._stopping or self.alive() or self._thread.ident is None:
            return
        if not self._thread.is_alive():
            self._fault("the link thread had ended and was restarted")
            self._round_s = self.monotonic_s()
            self._thread = threading.Thread(target=self._run, name="link", daemon=True)
            self._thread.start()
            return
        stalled_s, stream = self.monotonic_s() - self._round_s, self._stream
        self._round_s = self.monotonic_s()  # the watchdog acts again only after a further ``stalled_after_s``
        hangs = stream is not None and stream is self._closed_by_watch
        end = "its port is closed, so the driver of the instrument hangs: restart the unit on the page Fleet, or the server"
        consequence = end if hangs else "the port was closed"
        self.stall = f"The link thread made no progress for {stalled_s:.0f} s; {consequence}"
        self._fault(self.stall)
        self._closed_by_watch = stream
        if stream is not None:
            stream.close()

    def _fault(self, text: str) -> None:
        self.events.publish([LinkFault("critical", text)])

    def _run(self) -> None:
        while not self._stopping:
            self._round_s, self.stall = self.monotonic_s(), ""
            try:
                self._once()
            except Exception as error:  # the thread that owns the port must survive any fault
                log.exception("the contact failed")
                self.line_is_open, self.reason = False, f"{type(error).__name__}: {error}"
                self._report_failure(f"the contact was ended: {self.reason}")
                self._pause(RETRY_S)

    def _report_failure(self, text: str) -> None:
        """Report the failure of a contact; the same text at most once per ``REPORT_EVERY_S``, as it can recur for hours."""
        last_text, last_s = self._last_failure
        if text != last_text or self.monotonic_s() - last_s > REPORT_EVERY_S:
            self._last_failure = (text, self.monotonic_s())
            self._fault(text)

    def _once(self) -> None:
        """Open the line and serve it until the contact ends."""
        if not self.url:
            self._pause(0.5)
            return
        url, self._reopen = self.url, False
        try:
            stream = self._opened(url)
        except GssError as error:
            self._could_not_open(str(error))
            self._pause(RETRY_S)
            return
        self._stream = stream
        try:
            self._contact(stream, url)
        except BaseException:  # the port must be closed in all cases, so that the next attempt can open it
            stream.close()
            raise
        finally:
            self._stream = None
        if self.url == url and not self._reopen:
            # The line was lost. Without a pause, a device that closes the connection immediately would create many contacts.
            self._pause(REOPEN_S)

    def _opened(self, url: str) -> ByteStream:
        framing = self.session.framing
        if url.startswith(f"{CAN}://") != (framing == CAN):
            raise BadInput(
                f"{url} does not fit the sensor's framing {framing}",
                expected="can://… for the framing can, another address for every other framing",
                hint="choose another address, or the instrument that is on this line",
            )
        return (self._open_line or open_stream)(url, self._rules.baud or DEFAULT_BAUD)

    def _pause(self, seconds: float) -> None:
        self._wake.wait(seconds)
        self._wake.clear()

    def _could_not_open(self, reason: str) -> None:
        """Report the reason if it differs from the last reported one."""
        if reason != self.reason:
            self.events.publish([LinkFault("warning", f"{reason}. Retrying every {RETRY_S:g} s")])
        self.reason = reason

    def _contact(self, stream: ByteStream, url: str) -> None:
        continued = self._continues(url)
        if not continued:
            self._next_contact_id += 1
        contact_id = self._next_contact_id - 1
        self.events.publish([LineOpened(url, contact_id, self.capture.begin(contact_id), self.counters, continued)])
        self.line_is_open, self.reason = True, ""
        cause = "the port was changed"
        try:
            with self.lock.within(FOREVER):
                self.session.link_up(self.monotonic_s())
            self._exchange(stream, url)
            cause = self.reason or cause
        except LinkDown as error:
            cause = str(error)
            self._can_continue(url)
        except Exception as error:
            cause = f"{type(error).__name__}: {error}"
            self._can_continue(url)
            raise
        finally:
            stream.close()
            self._end_contact(cause)

    def _can_continue(self, url: str) -> None:
        if self.url == url and not self._reopen:
            self._lost_line = (url, self.monotonic_s())

    def _continues(self, url: str) -> bool:
        """True if the last contact was on this line and the line was lost less than ``JOIN_WITHIN_S`` ago."""
        lost_line, self._lost_line = self._lost_line, None
        return lost_line is not None and lost_line[0] == url and self.monotonic_s() - lost_line[1] < JOIN_WITHIN_S

    def _exchange(self, stream: ByteStream, url: str) -> None:
        while self.url == url and not self._reopen and not self._stopping:
            self._round_s, self.stall = self.monotonic_s(), ""
            data = stream.read(READ_BYTES, READ_WAIT_S)
            self.capture.write(RECEIVED, data)
            now_s = self.monotonic_s()
            with self.lock.within(FOREVER):
                events = list(self.session.feed(data, now_s)) if data else []
                out, polled = self.session.poll(now_s)
            # Before the write, because a failed write must not lose these events.
            self.events.publish([*events, *polled])
            if out:
                self.capture.write(SENT, out)
                stream.write(out)

    def _end_contact(self, cause: str) -> None:
        self.line_is_open, self.reason = False, cause
        with self.lock.within(FOREVER):
            events = self.session.link_lost(self.monotonic_s())
        self.events.publish([*events, self.counters])
        self.capture.end()
        self.events.publish([LineClosed(cause, self.counters)])

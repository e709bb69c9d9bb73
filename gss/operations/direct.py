"""A device on a port without a server: for scripts. One thing at a time, and the port is given back at the end."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

from gss.device.dictionary import Dictionary, Value
from gss.device.session import HostSession
from gss.device.session_events import (
    FINAL_STAGES,
    CommandStage,
    HelloReceived,
    SessionEvent,
    Stage,
    TransferDone,
    TransferState,
    TransferUpdate,
)
from gss.device.transport import ByteStream, open_stream
from gss.domain.errors import Conflict, LinkDown
from gss.operations.build_catalogue import bank_number, compatibility_of
from gss.operations.clock import Monotonic

READ_BYTES = 65536
READ_WAIT_S = 0.02
HELLO_WITHIN_S = 15.0
ENDS = (TransferState.FAILED, TransferState.ABORTED)

Watch = Callable[[TransferUpdate], None]


class DirectDevice:
    """A host session driven by the caller's own thread."""

    def __init__(self, stream: ByteStream, dictionary: Dictionary, monotonic_s: Monotonic) -> None:
        self._stream, self._dictionary, self._now_s = stream, dictionary, monotonic_s
        self._session = HostSession(dictionary)
        self._session.link_up(monotonic_s())
        self.hello = self._meet()

    def upload(self, image: bytes, bank: str, watch: Watch) -> str:
        """Send a bank image, have it read back and committed; the SHA-256 that the device confirmed."""
        target, compatibility = bank_number(self._dictionary, bank), compatibility_of(image, self.hello)
        transfer_id = self._session.start_upload("catalogue", target, image, compatibility, self._now_s())
        for event in self._events():
            if isinstance(event, TransferUpdate) and event.transfer_id == transfer_id:
                watch(event)
                if event.state in ENDS:
                    raise Conflict(f"the upload to bank {bank} ended as {event.state}", got=event.reason)
            if isinstance(event, TransferDone) and event.transfer_id == transfer_id:
                return event.sha256
        raise LinkDown("the line ended before the upload did")

    def command(self, name: str, arguments: Mapping[str, Value]) -> CommandStage:
        """Send a command and wait for its end; Conflict when it is rejected, fails or stays without a report."""
        request_id = self._session.submit(name, arguments, self._now_s())
        for event in self._events():
            if isinstance(event, CommandStage) and event.request_id == request_id:
                if event.stage is Stage.COMPLETED:
                    return event
                if event.stage in FINAL_STAGES or event.stage is Stage.UNKNOWN:
                    raise Conflict(f"{name} ended as {event.stage}", got=f"{event.reason} {event.detail}".strip())
        raise LinkDown(f"the line ended before {name} did")

    def _meet(self) -> HelloReceived:
        deadline_s = self._now_s() + HELLO_WITHIN_S
        for event in self._events():
            if isinstance(event, HelloReceived):
                return event
            if self._now_s() > deadline_s:
                break
        raise LinkDown("nobody answered", expected=f"a device within {HELLO_WITHIN_S:g} s", hint="check port and power")

    def _events(self) -> Iterator[SessionEvent | None]:
        """What comes, one by one; None when a turn brought nothing, so that the caller can look at the time."""
        while True:
            data = self._stream.read(READ_BYTES, READ_WAIT_S)
            events = list(self._session.feed(data, self._now_s()))
            out, more = self._session.poll(self._now_s())
            if out:
                self._stream.write(out)
            events += more
            yield from events
            if not events:
                yield None


@contextmanager
def direct_device(url: str, dictionary: Dictionary, monotonic_s: Monotonic) -> Iterator[DirectDevice]:
    """The device on that port, after it has answered."""
    stream = open_stream(url)
    try:
        yield DirectDevice(stream, dictionary, monotonic_s)
    finally:
        stream.close()

"""Direct access to a device on a port, for scripts that run without a server. Operations run one at a time. The port is closed
at the end."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager

from gss.device.driver import Driver, open_driver
from gss.device.protocol.authentication import PacketSigner
from gss.device.protocol.transfer import Compatibility
from gss.device.session_events import (
    FINAL_STAGES,
    CommandUpdate,
    HelloReceived,
    SessionEvent,
    Stage,
    Telemetry,
    TransferDone,
    TransferState,
    TransferUpdate,
)
from gss.device.session_transfer import Part
from gss.device.transport import DEFAULT_BAUD, ByteStream, open_stream
from gss.domain.errors import Conflict, LinkDown
from gss.instruments.dictionary.definitions import Dictionary, Value
from gss.instruments.package import Instrument
from gss.instruments.roles import default_roles
from gss.operations.catalogues.build_catalogue import compatibility_of
from gss.operations.clock import Monotonic
from gss.operations.transfers.flash_banks import CATALOGUES

READ_BYTES = 65536
READ_WAIT_S = 0.02
HELLO_WITHIN_S = 15.0
STALLED_S = 60.0
ENDS = (TransferState.FAILED, TransferState.ABORTED)

Watch = Callable[[TransferUpdate], None]


class DirectDevice:
    """A host session that runs in the caller's thread."""

    def __init__(
        self,
        stream: ByteStream,
        session: Driver,
        dictionary: Dictionary,
        monotonic_s: Monotonic,
    ) -> None:
        self._stream, self._session, self._dictionary, self._now_s = stream, session, dictionary, monotonic_s
        self.packets: dict[str, Telemetry] = {}
        """Latest packet of each kind, also those that answered a command."""
        self._session.link_up(monotonic_s())
        self.hello = self._meet()

    def upload(self, image: bytes, bank: str, watch: Watch) -> str:
        """Upload a bank image, including read-back and commit. Return the SHA-256 that the device confirmed."""
        target, compatibility = (
            CATALOGUES.number(default_roles(self._dictionary).operations, bank),
            compatibility_of(image, self.hello),
        )
        transfer_id = self._session.transfers.start_upload("catalogue", target, image, compatibility)
        return self._finish(transfer_id, f"the upload to bank {bank}", watch).sha256

    def upload_table(self, kind: str, data: bytes, target: int, format_version: int, watch: Watch) -> str:
        """Upload a table to bank ``target``, including read-back and commit. Return the SHA-256 that the device confirmed."""
        model, profile = self.hello.device_model, self.hello.profile
        compatibility = Compatibility(model, profile, self._dictionary.hash, format_version)
        transfer_id = self._session.transfers.start_upload(kind, target, data, compatibility)
        return self._finish(transfer_id, f"the upload of {kind} {target}", watch).sha256

    def download(self, kind: str, target: int, watch: Watch, part: Part | None = None) -> TransferDone:
        """Download the content of a slot or bank, or a part of an image. The result contains the hash that the device
        reported."""
        transfer_id = self._session.transfers.start_download(kind, target, part=part)
        return self._finish(transfer_id, f"the download of {kind} {target}", watch)

    def _finish(self, transfer_id: int, transfer_name: str, watch: Watch) -> TransferDone:
        """Wait for the end of a transfer and return its result. Raises Conflict if the transfer fails or is aborted, LinkDown
        if it stalls or the line closes."""
        stored_bytes, progress_s = -1, self._now_s()
        for event in self._events():
            if isinstance(event, TransferDone) and event.transfer_id == transfer_id:
                return event
            if isinstance(event, TransferUpdate) and event.transfer_id == transfer_id:
                watch(event)
                if event.state in ENDS:
                    raise Conflict(f"{transfer_name} ended as {event.state}", got=event.reason)
                if event.stored_bytes != stored_bytes:
                    stored_bytes, progress_s = event.stored_bytes, self._now_s()
            if self._now_s() - progress_s > STALLED_S:
                raise LinkDown(f"{transfer_name} stalled", got=f"no new data stored for {STALLED_S:g} s")
        raise LinkDown(f"the line closed before the end of {transfer_name}")

    def command(self, name: str, arguments: Mapping[str, Value]) -> CommandUpdate:
        """Send a command, wait until it is completed and return its report. Raises Conflict if the command is rejected, fails
        or times out."""
        request_id = self._session.submit(self._session.encode(name, arguments))
        for event in self._events():
            if isinstance(event, CommandUpdate) and event.request_id == request_id:
                if event.stage is Stage.COMPLETED:
                    return event
                if event.stage in FINAL_STAGES or event.stage is Stage.UNKNOWN:
                    raise Conflict(f"{name} ended as {event.stage}", got=f"{event.reason} {event.detail}".strip())
        raise LinkDown(f"the line closed before the end of {name}")

    def watch(self, seconds: float) -> list[SessionEvent]:
        """Run the session for this time and return its events."""
        events: list[SessionEvent] = []
        end_s = self._now_s() + seconds
        while self._now_s() < end_s:
            events += self.turn()
        return events

    def disturb(self, data: bytes) -> None:
        """Write bytes that are not a valid packet to the line."""
        self._stream.write(data)

    def _meet(self) -> HelloReceived:
        deadline_s = self._now_s() + HELLO_WITHIN_S
        for event in self._events():
            if isinstance(event, HelloReceived):
                return event
            if self._now_s() > deadline_s:
                break
        raise LinkDown(f"no response from the device within {HELLO_WITHIN_S:g} s", hint="check port and power")

    def turn(self) -> list[SessionEvent]:
        """Read the available bytes, waiting at most ``READ_WAIT_S``, and write pending packets. Return the session's events."""
        data = self._stream.read(READ_BYTES, READ_WAIT_S)
        events = list(self._session.feed(data, self._now_s()))
        out, polled = self._session.poll(self._now_s())
        if out:
            self._stream.write(out)
        self.packets |= {event.packet: event for event in events + polled if isinstance(event, Telemetry)}
        return events + polled

    def _events(self) -> Iterator[SessionEvent | None]:
        """Yield the session's events. Yield None after each turn without events, so the caller can check its deadline."""
        while True:
            events = self.turn()
            yield from events
            if not events:
                yield None


@contextmanager
def direct_device(
    url: str, instrument: Instrument, monotonic_s: Monotonic, signer: PacketSigner | None = None
) -> Iterator[DirectDevice]:
    """Open the device of an instrument on a port and wait for its answer. Close the port at the end."""
    stream = open_stream(url, instrument.link.baud or DEFAULT_BAUD)
    try:
        yield DirectDevice(stream, open_driver(instrument, signer=signer), instrument.dictionary, monotonic_s)
    finally:
        stream.close()

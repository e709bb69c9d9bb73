"""Host side of a contact, without I/O: its inputs are bytes and times, its outputs are bytes and events.

``HostSession`` manages commands (queue, timeouts, retries), ``transfers`` and counters. Its owner calls ``link_up``
when a port is open, ``feed`` with received bytes, and ``poll`` every 10–50 ms, and writes the bytes that ``poll``
returns. All times are ``now_s`` of the owner's monotonic clock. Not thread-safe: several threads need a lock.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from gss.device.driver import InFlight, UnitSetup
from gss.device.protocol.authentication import PacketSigner
from gss.device.protocol.codec import EncodedCommand, decode, encode, encode_command
from gss.device.protocol.packet import CRC_BYTES, Arrival, Packet, PacketType, labelled_bytes
from gss.device.protocol.receiver import LineReceiver
from gss.device.protocol.sender import LineSender
from gss.device.session_commands import CommandQueue
from gss.device.session_counters import LineQuality, count_line
from gss.device.session_events import (
    CommandUpdate,
    HelloReceived,
    LinkCounters,
    SessionEvent,
    Stage,
    TransferUpdate,
)
from gss.device.session_handshake import HELLO_AGAIN_S, Handshake
from gss.device.session_pacing import Pacer
from gss.device.session_reading import read_event, read_report
from gss.device.session_telemetry import TelemetryReader
from gss.device.session_transfer import RequestIds, ServiceMessage
from gss.device.session_transfers import TransferManager
from gss.domain.errors import BadInput, CorruptData
from gss.instruments.dictionary.definitions import CommandDefinition, Dictionary, Value

COUNTERS_EVERY_S = 1.0
STALE_ONLY_S = 3.0
UNPACED_CHUNKS = 32


def open_session(setup: UnitSetup) -> HostSession:
    """Return the session of the driver ``gss``."""
    link = setup.link
    framing = setup.framing or link.framing
    return HostSession(setup.dictionary, framing=framing, signer=setup.signer, hello_again_s=link.hello_again_s)


class HostSession:
    """Session with one device on one line; see the module docstring.

    A method that raises BadInput, NotFound or Conflict has no effect.
    """

    def __init__(
        self,
        dictionary: Dictionary,
        *,
        next_request_id: int = 1,
        next_transfer_id: int = 1,
        framing: str = "cobs",
        signer: PacketSigner | None = None,
        hello_again_s: float = HELLO_AGAIN_S,
    ) -> None:
        self._dictionary, self._reader = dictionary, TelemetryReader(dictionary)
        self.framing, self.stores_results = framing, True
        self._ids, self._command_queue = RequestIds(next_request_id), CommandQueue()
        self._sender = LineSender(to_device=True, prefix=dictionary.prefix, framing=framing, signer=signer)
        self._receiver, self._quality = LineReceiver(from_device=True, framing=framing), LineQuality()
        self.transfers = TransferManager(dictionary, self._quality, next_transfer_id)
        self._events: list[SessionEvent] = []
        self._up, self._handshake = False, Handshake(dictionary, self._sender, hello_again_s)
        self._housekeeping: Mapping[str, Value] | None = None
        self._last_good_s: float | None = None
        self._undecodable = self._repeated_ids = 0
        self._pacer = Pacer()
        self._counted_s = self._current_s = -1e9

    # --- commands -----------------------------------------------------------------------------------------------

    def encode(self, name: str, arguments: Mapping[str, Value]) -> EncodedCommand:
        """Validate and encode a command for ``preview`` and ``submit``; missing arguments take their defaults.

        Raises BadInput ("0 – 255, got 300") if a value is out of range, NotFound if there is no such command.
        """
        return encode_command(self._dictionary.command(name), arguments)

    def submit(self, order: EncodedCommand, *, request_id: int | None = None) -> int:
        """Queue a command and return its request id: ``request_id`` if the caller reserved one, otherwise a new id.

        Commands wait until the device has identified itself; ABORT does not wait. Raises Conflict while a dictionary
        mismatch is unacknowledged.
        """
        self.check_allowed(order.command.name)
        used = self._ids() if request_id is None else request_id
        self._events.append(self._command_queue.add(used, order))
        return used

    def reserve(self) -> int:
        """Return a request id for a later ``submit``, so that the owner can store it before the command is queued."""
        return self._ids()

    def check_allowed(self, name: str) -> None:
        """Raise Conflict while a dictionary mismatch is unacknowledged, NotFound if there is no such command."""
        self._handshake.check_allowed(name)

    def preview(self, order: EncodedCommand) -> list[tuple[str, bytes]]:
        """Return the packet before framing as labelled groups (dry run); each argument is a group labelled with its
        name.

        The packet has the request id of the next ``submit``. The preview uses no sequence count.
        """
        code, payload = order.command.code, order.payload
        packet = self._sender.next_packet(PacketType.COMMAND, code, self._ids.following, payload)
        return [*labelled_bytes(packet), *order.groups, ("CRC-32", packet[-CRC_BYTES:])]

    def check_retry(self, request_id: int) -> None:
        """Raise Conflict or NotFound if the command cannot be retried; see ``CommandQueue.check_retry``."""
        self._command_queue.check_retry(request_id)

    def retry(self, request_id: int, now_s: float) -> None:
        """Send the same bytes with the same id again; see ``check_retry``."""
        self._events.append(self._command_queue.retry(request_id))

    def withdraw(self, request_id: int, detail: str) -> CommandUpdate:
        """Withdraw a queued command and return its new stage. ``poll`` does not report this stage again.

        Raises Conflict if the command is not in the queue.
        """
        return self._command_queue.withdraw(request_id, detail)

    def withdraw_all(self, detail: str) -> list[CommandUpdate]:
        """Withdraw all queued commands; see ``withdraw``."""
        return self._command_queue.clear(detail)

    def abort(self, now_s: float) -> int:
        """Queue ABORT before all other commands; it is never blocked. Returns its request id."""
        request_id = self._ids()
        self._events.append(self._command_queue.add(request_id, self.encode("ABORT", {}), urgent=True))
        return request_id

    def acknowledge_mismatch(self) -> None:
        """Accept the device's different dictionary until another one answers; packets then have the device's prefix."""
        self._handshake.acknowledge()
        if self._handshake.greeted:
            self.transfers.line_back()

    def restore(self, next_request_id: int, in_flight: Sequence[InFlight], next_transfer_id: int = 1) -> None:
        """Set the next ids after a restart. Commands ``in_flight`` get the stage UNKNOWN and can be retried."""
        self._ids.following = next_request_id
        self.transfers.skip_ids(next_transfer_id)
        self._events += [self._command_queue.add_unknown(*command) for command in in_flight]

    def craft(
        self, kind: PacketType, code: int, payload: bytes, *, request_id: int | None = None, prefix: int | None = None
    ) -> tuple[int, bytes]:
        """Return the request id and the frame of an arbitrary packet that this session does not track, for device tests.

        Without ``request_id`` a new id is used; without ``prefix`` the prefix of the session.
        """
        used = self._ids() if request_id is None else request_id
        return used, self._sender.packet(kind, code, used, payload, prefix=prefix)

    def transfer(self, transfer_id: int) -> TransferUpdate:
        """Return the transfer's state at the last poll. Raises NotFound."""
        return self.transfers.get(transfer_id).update(self._pacer.polled_s or 0.0, self.transfers.line_bytes_s)

    # --- line ---------------------------------------------------------------------------------------------------

    def link_up(self, now_s: float) -> None:
        """Start on a newly opened port: reset the parsers, send HELLO until it is answered, then resume transfers."""
        self._receiver.restart()
        self._up = True
        self._handshake.begin(now_s)
        self._pacer.restart(now_s)

    def link_lost(self, now_s: float) -> list[SessionEvent]:
        """Handle the loss of the port: commands sent become UNKNOWN, transfers link_lost."""
        self._up = False
        self._handshake.ask_at(None)
        self.transfers.lose_line()
        self._events += self._command_queue.lose_all("The line was lost while the command was under way.")
        return self._take_events(now_s)

    def feed(self, data: bytes, now_s: float) -> list[SessionEvent]:
        """Process received bytes and return the resulting events. Invalid bytes raise no exception."""
        for packet in self._receiver.feed(data):
            self._last_good_s = now_s
            try:
                self._dispatch(packet, now_s)
            except (CorruptData, BadInput):
                self._undecodable += 1
        return self._take_events(now_s)

    def poll(self, now_s: float) -> tuple[bytes, list[SessionEvent]]:
        """Return the bytes to write now and the events since the last call (timeouts, suspended transfers, progress)."""
        out: list[bytes] = []
        if self._up:
            self._pacer.refill(now_s, self.transfers.line_bytes_s)
            self._events += self._command_queue.expire(now_s)
            if self._handshake.is_due(now_s):
                self._events.append(self._command_queue.add_hello(self._ids(), self.encode("HELLO", {})))
            out += self._commands(now_s)
            out += [self._frame(m) for m in self.transfers.step(now_s, self._ids)]
            self._pacer.spend(sum(map(len, out)))
            out += self._chunks(now_s)
        if now_s - self._counted_s >= COUNTERS_EVERY_S:
            self._counted_s = now_s
            self._quality.note(now_s, self._sender, self._receiver, self._housekeeping)
            self._events.append(self.counters)
        return b"".join(out), self._take_events(now_s)

    def _commands(self, now_s: float) -> list[bytes]:
        records, events = self._command_queue.release(now_s, only_urgent=not self._handshake.greeted)
        self._events += events
        return [self._sender.packet(PacketType.COMMAND, r.command.code, r.request_id, r.payload) for r in records]

    def _chunks(self, now_s: float) -> list[bytes]:
        frames: list[bytes] = []
        paced = self.transfers.line_bytes_s is not None
        while self._pacer.open if paced else (len(frames) < UNPACED_CHUNKS):
            message = self.transfers.next_chunk(now_s)
            if message is None:
                break
            frames.append(self._frame(message))
            self._pacer.spend(len(frames[-1]))
        return frames

    def _frame(self, message: ServiceMessage) -> bytes:
        service = self._dictionary.service(message.service)
        payload = encode(service.fields, message.values, message.lists)
        return self._sender.packet(PacketType.TRANSFER, service.code, message.request_id, payload)

    # --- received packets ---------------------------------------------------------------------------------------

    def _dispatch(self, packet: Packet, now_s: float) -> None:
        command = self._dictionary.command_of_code(packet.code) if packet.type is PacketType.REPORT else None
        if command is not None:
            self._report(packet, command, now_s)
        elif not self._handshake.can_decode(packet.prefix):
            # Telemetry of another dictionary would decode to wrong values.
            self._undecodable += 1
        elif packet.type is PacketType.TELEMETRY:
            self._telemetry(packet, now_s)
        elif packet.type is PacketType.EVENT:
            self._event(packet, now_s)
        elif packet.type is PacketType.TRANSFER:
            service = self._dictionary.service_of_code("transfer", packet.code)
            if service is None:
                self._undecodable += 1
            else:
                self.transfers.receive(service.name, packet.request_id, decode(service.fields, packet.payload), now_s)
        else:
            self._undecodable += 1

    def _report(self, packet: Packet, command: CommandDefinition, now_s: float) -> None:
        sent = self._command_queue.record(packet.request_id)
        if sent is not None and sent.command.code != command.code:
            # Otherwise the values would be assigned to the command that was sent with this id.
            raise CorruptData("a report names another command", expected=sent.command.name, got=command.name)
        stage_reached, facts = read_report(packet, command, self._dictionary)
        stages = self._command_queue.report(packet.request_id, stage_reached, now_s, facts)
        self._repeated_ids += bool(facts["replayed"]) or not stages
        self._events += stages
        for stage in stages:
            if stage.stage is Stage.COMPLETED:
                self._completed(stage, packet, now_s)

    def _completed(self, stage: CommandUpdate, packet: Packet, now_s: float) -> None:
        if stage.name == "HELLO":
            self._identified(stage.values, packet.time_s)
        elif stage.name == "CONFIRM_BANK" and self._housekeeping is not None:
            record = self._command_queue.record(stage.request_id)
            if record is not None:
                self.transfers.bank_in_use(record.payload[0])

    def _identified(self, values: Mapping[str, Value], device_time_s: float) -> None:
        previous, hello = self._handshake.hello, self._handshake.met(values, device_time_s)
        self._events += self._command_queue.identified(hello.unit_name)
        self.transfers.identified(hello.unit_name)
        if previous is None or (previous.serial, previous.boot_count) != (hello.serial, hello.boot_count):
            self._receiver.sequence.restart()
        self._receiver.sequence.hello(device_time_s)
        self.transfers.line_bytes_s = hello.line_baud / 10 if hello.line_baud else None
        # Ids that the device has stored must not be used again, even if the host's database was lost.
        self._ids.following = max(self._ids.following, hello.last_request_id % 0xFFFF_FFFF + 1)
        self._events.append(hello)
        if self._handshake.agreed:
            self.transfers.line_back()

    def _telemetry(self, packet: Packet, now_s: float) -> None:
        telemetry = self._reader.read(packet)
        if telemetry is None:
            self._undecodable += 1
            return
        if telemetry.arrival is not Arrival.CURRENT:
            self._greet_if_restarted(now_s)
        else:
            self._current_s = now_s
            if telemetry.packet == "housekeeping":
                self._housekeeping = telemetry.values
        self._events.append(telemetry)

    def _greet_if_restarted(self, now_s: float) -> None:
        """Send HELLO if only late telemetry arrives. Perhaps the device restarted and its BOOT event was lost."""
        if now_s - self._current_s >= STALE_ONLY_S and self._handshake.greeted:
            self._current_s = now_s
            self._handshake.ask_at(now_s)

    def _event(self, packet: Packet, now_s: float) -> None:
        definition = self._dictionary.event_of_code(packet.code)
        if definition is None:
            self._undecodable += 1
            return
        self._events.append(read_event(packet, definition, self._dictionary))
        if definition.name == "BOOT":
            if packet.arrival is Arrival.CURRENT:
                self.transfers.device_restarted(now_s)
            self._handshake.ask_at(now_s)

    def _take_events(self, now_s: float) -> list[SessionEvent]:
        events, self._events = [*self._events, *self.transfers.news(now_s)], []
        return events

    # --- state --------------------------------------------------------------------------------------------------

    @property
    def counters(self) -> LinkCounters:
        """Counters since the session was created."""
        return count_line(self._sender, self._receiver, self._undecodable, self._last_good_s, self._repeated_ids)

    @property
    def next_request_id(self) -> int:
        """Request id of the next command or transfer opening; the owner stores it for a restart."""
        return self._ids.following

    @property
    def housekeeping(self) -> Mapping[str, Value] | None:
        """Latest housekeeping in engineering units, for preconditions."""
        return self._housekeeping

    @property
    def hello(self) -> HelloReceived | None:
        """The last identity received from the device."""
        return self._handshake.hello

    @property
    def device_dictionary_hash(self) -> str | None:
        """Dictionary hash in the last HELLO."""
        return self.hello.dictionary_hash if self.hello else None

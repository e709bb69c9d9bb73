"""Host side of a contact, without I/O: takes bytes and a clock, returns bytes and events.

``HostSession`` keeps commands (queue, timeouts, retries), transfers and counters. It owns no thread and no port: its
owner calls ``link_up`` when a port is open, ``feed`` with received bytes, and ``poll`` every 10–50 ms, and writes the
bytes that ``poll`` returns. All times are ``now_s`` of the owner's monotonic clock. Not thread-safe: an owner with
several threads needs a lock.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from gss.device.dictionary import Command, Dictionary, Value
from gss.device.protocol.codec import decode, encode
from gss.device.protocol.line import LineReceiver, LineSender
from gss.device.protocol.packet import Packet, PacketType
from gss.device.protocol.transfer import Compatibility
from gss.device.session_commands import CommandLane
from gss.device.session_counters import LineQuality, count_line
from gss.device.session_events import (
    CommandStage,
    Direction,
    HelloReceived,
    LinkCounters,
    Ranges,
    SessionEvent,
    Stage,
    TransferState,
    TransferUpdate,
)
from gss.device.session_handshake import Handshake
from gss.device.session_pacing import Pacer
from gss.device.session_packets import command_preview, crafted_frame
from gss.device.session_reading import TelemetryReader, read_event, read_report
from gss.device.session_transfer import HeldPart, Message, Part, RequestIds, Transfer, checked_target
from gss.device.session_transfers import TransferDesk
from gss.domain.errors import BadInput, CorruptData

__all__ = ["Compatibility", "HeldPart", "HostSession", "InFlight", "Part"]

InFlight = tuple[int, str, Mapping[str, Value]]
"""(request id, command name, arguments)."""

COUNTERS_EVERY_S = 1.0
UNPACED_CHUNKS = 32


class HostSession:
    """Session with one device on one line; see the module docstring.

    Methods that raise BadInput, NotFound or Conflict change nothing.
    """

    def __init__(
        self, dictionary: Dictionary, *, next_request_id: int = 1, next_transfer_id: int = 1, framing: str = "cobs"
    ) -> None:
        self._dictionary, self._reader = dictionary, TelemetryReader(dictionary)
        self._ids = RequestIds(next_request_id)
        self._next_transfer_id = next_transfer_id
        self._lane = CommandLane(dictionary)
        self._desk = TransferDesk()
        self._sender = LineSender(to_device=True, prefix=dictionary.prefix, framing=framing)
        self._receiver = LineReceiver(from_device=True, framing=framing)
        self._quality = LineQuality()
        self._events: list[SessionEvent] = []
        self._up = False
        self._handshake = Handshake(dictionary, self._sender)
        self._housekeeping: Mapping[str, Value] | None = None
        self._last_good_s: float | None = None
        self._undecodable = self._repeated_ids = 0
        self._pacer = Pacer()
        self._counted_s = -1e9

    # --- commands -----------------------------------------------------------------------------------------------

    def submit(self, name: str, arguments: Mapping[str, Value], now_s: float, *, request_id: int | None = None) -> int:
        """Queue a command and return its request id: ``request_id`` if reserved before, else a new one.

        Missing arguments take their defaults. Commands wait until the device has identified itself; only ABORT does
        not. Raises BadInput ("0 – 255, got 300") if a value is out of range, Conflict while a dictionary mismatch is
        unacknowledged.
        """
        self.check_allowed(name)
        if request_id is None:
            return self._add(name, arguments, urgent=False)
        self._events.append(self._lane.add(request_id, name, arguments))
        return request_id

    def reserve(self) -> int:
        """Return a request id for a later ``submit``, so that the owner can store it before the command is queued."""
        return self._ids()

    def check_allowed(self, name: str) -> None:
        """Raise Conflict while a dictionary mismatch is unacknowledged, NotFound if there is no such command."""
        self._handshake.check_allowed(name)

    def _add(self, name: str, arguments: Mapping[str, Value], *, urgent: bool) -> int:
        event = self._lane.add(self._ids.following, name, arguments, urgent=urgent)
        self._events.append(event)
        return self._ids()

    def preview(self, name: str, arguments: Mapping[str, Value]) -> list[tuple[str, bytes]]:
        """Return the packet before framing as labelled groups (dry run); an argument's group has its name as label.

        The request id shown is the one the next submit would take.
        """
        return command_preview(self._dictionary, self._sender, self._ids.following, name, arguments)

    def retry(self, request_id: int, now_s: float) -> None:
        """Send the same bytes with the same id again. Raises Conflict unless the command's stage is UNKNOWN."""
        self._events.append(self._lane.retry(request_id))

    def withdraw(self, request_id: int, detail: str) -> CommandStage:
        """Withdraw a queued command and return its new stage, which is not repeated in the events.

        Raises Conflict if the command is not in the queue.
        """
        return self._lane.withdraw(request_id, detail)

    def withdraw_all(self, detail: str) -> list[CommandStage]:
        """Withdraw all queued commands; see ``withdraw``."""
        return self._lane.clear(detail)

    def abort(self, now_s: float) -> int:
        """Queue ABORT ahead of everything; it is never blocked. Returns its request id."""
        return self._add("ABORT", {}, urgent=True)

    def acknowledge_mismatch(self) -> None:
        """Accept that the device has another dictionary; packets are then sent with the device's prefix."""
        self._handshake.acknowledge()

    def restore(self, next_request_id: int, in_flight: Sequence[InFlight], next_transfer_id: int = 1) -> None:
        """Seed the ids after a restart. Commands ``in_flight`` get the stage UNKNOWN and may be retried."""
        self._ids.following = next_request_id
        self._next_transfer_id = max(self._next_transfer_id, next_transfer_id)
        for request_id, name, arguments in in_flight:
            self._events.append(self._lane.add_unknown(request_id, name, arguments))

    def craft(
        self, kind: PacketType, code: int, payload: bytes, *, request_id: int | None = None, prefix: int | None = None
    ) -> tuple[int, bytes]:
        """Return the request id and the frame of an arbitrary packet that this session does not track, for device tests.

        The id is a new one and the prefix the dictionary's, unless given.
        """
        used = self._ids() if request_id is None else request_id
        return used, crafted_frame(self._sender, kind, code, used, payload, prefix)

    # --- transfers ----------------------------------------------------------------------------------------------

    def start_download(
        self,
        kind: str,
        slot: int,
        now_s: float,
        *,
        held: HeldPart | None = None,
        chunk_bytes: int | None = None,
        part: Part | None = None,
        paused: str = "",
    ) -> int:
        """Queue a download of any kind the dictionary defines and return its transfer id.

        ``held``: data of an earlier attempt; only missing chunks are requested if the content is unchanged. ``part``:
        the region, or the side of star windows. ``chunk_bytes``: fixed chunk size, not adapted to the line. ``paused``:
        reason to wait until the device has identified itself.
        """
        size = self._chunk_size(kind, chunk_bytes, Direction.DOWN)
        transfer = Transfer(self._next_transfer_id, Direction.DOWN, kind, checked_target(slot), size)
        transfer.part, transfer.grid_is_fixed = part or Part(), chunk_bytes is not None
        if held is not None:
            transfer.take_held(held)
        return self._queue(transfer, paused)

    def start_upload(
        self,
        kind: str,
        target: int,
        data: bytes,
        compatibility: Compatibility,
        now_s: float,
        *,
        chunk_bytes: int | None = None,
        paused: str = "",
    ) -> int:
        """Queue an upload to a bank or slot number and return its transfer id; verify and commit follow automatically.

        The same data to the same target resumes after an interruption with what the device still holds. ``chunk_bytes``
        and ``paused`` as in ``start_download``.
        """
        if not data:
            raise BadInput("nothing to upload", expected="at least 1 byte", got="0 bytes")
        size = self._chunk_size(kind, chunk_bytes, Direction.UP)
        transfer = Transfer(self._next_transfer_id, Direction.UP, kind, checked_target(target), size, compatibility)
        transfer.take_content(data)
        transfer.grid_is_fixed = chunk_bytes is not None
        return self._queue(transfer, paused)

    def _chunk_size(self, kind: str, wanted: int | None, direction: Direction) -> int:
        """Return the chunk size to request. Raises BadInput if the dictionary does not define the kind."""
        opening = self._dictionary.service("OPEN_DOWNLOAD")
        item = next(f for f in opening.fields if f.name == "kind")
        encode([item], {"kind": kind})  # type: ignore[list-item]  # an item of a service is an Item
        return wanted or self._quality.chunk_bytes(direction)

    def _queue(self, transfer: Transfer, paused: str) -> int:
        if paused and not self._desk.line_is_up:
            transfer.waits_for_device = True
            transfer.to(TransferState.PAUSED, paused)
        self._desk.add(transfer)
        self._next_transfer_id += 1
        return transfer.id

    def pause_transfer(self, transfer_id: int, now_s: float) -> None:
        """Pause a transfer. Raises Conflict unless it is queued, opening, transferring or link_lost."""
        self._desk.pause(transfer_id)

    def resume_transfer(self, transfer_id: int, now_s: float) -> None:
        """Resume a transfer. Raises Conflict unless it is paused, link_lost or failed."""
        self._desk.resume(transfer_id)

    def abort_transfer(self, transfer_id: int, now_s: float) -> None:
        """Abort a transfer at both ends; received data stays readable with ``partial``."""
        self._desk.abort(transfer_id)

    def partial(self, transfer_id: int) -> tuple[bytes, Ranges]:
        """Return the data of a download, (size,) bytes with zeros for missing chunks, and the held chunk ranges."""
        transfer = self._desk.get(transfer_id)
        return bytes(transfer.data), transfer.stored()[0]

    def transfer(self, transfer_id: int) -> TransferUpdate:
        """Return the transfer's state at the last poll. Raises NotFound."""
        return self._desk.get(transfer_id).update(self._pacer.polled_s or 0.0, self._desk.line_bytes_s)

    def forget_transfer(self, transfer_id: int) -> None:
        """Free the memory of a transfer that has ended."""
        self._desk.forget(transfer_id)

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
        self._desk.lose_line()
        self._events += self._lane.lose_all("The line was lost while the command was under way.")
        return self._take_events(now_s)

    def feed(self, data: bytes, now_s: float) -> list[SessionEvent]:
        """Process received bytes and return the resulting events. Never raises, whatever the bytes are."""
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
            self._pacer.refill(now_s, self._desk.line_bytes_s)
            self._events += self._lane.expire(now_s)
            self._greet(now_s)
            out += self._commands(now_s)
            out += [self._frame(m) for m in self._desk.step(now_s, self._ids)]
            self._pacer.spend(sum(map(len, out)))
            out += self._chunks(now_s)
        if now_s - self._counted_s >= COUNTERS_EVERY_S:
            self._counted_s = now_s
            self._quality.note(now_s, self._sender, self._receiver, self._housekeeping)
            self._events.append(self.counters)
        return b"".join(out), self._take_events(now_s)

    def _greet(self, now_s: float) -> None:
        if self._handshake.is_due(now_s):
            self._add("HELLO", {}, urgent=True)

    def _commands(self, now_s: float) -> list[bytes]:
        records, events = self._lane.release(now_s, only_urgent=not self._handshake.greeted)
        self._events += events
        return [self._sender.packet(PacketType.COMMAND, r.command.code, r.request_id, r.payload) for r in records]

    def _chunks(self, now_s: float) -> list[bytes]:
        frames: list[bytes] = []
        paced = self._desk.line_bytes_s is not None
        while self._pacer.open if paced else (len(frames) < UNPACED_CHUNKS):
            message = self._desk.next_chunk(now_s)
            if message is None:
                break
            frames.append(self._frame(message))
            self._pacer.spend(len(frames[-1]))
        return frames

    def _frame(self, message: Message) -> bytes:
        service = self._dictionary.service(message.service)
        payload = encode(service.fields, message.values, message.lists)
        return self._sender.packet(PacketType.TRANSFER, service.code, message.request_id, payload)

    # --- received packets ---------------------------------------------------------------------------------------

    def _dispatch(self, packet: Packet, now_s: float) -> None:
        command = self._dictionary.command_of_code(packet.code) if packet.type is PacketType.REPORT else None
        if command is not None:
            self._report(packet, command, now_s)
        elif packet.prefix != self._dictionary.prefix and not self._handshake.acknowledged:
            # Telemetry of another dictionary would decode to wrong values.
            self._undecodable += 1
        elif packet.type is PacketType.TELEMETRY:
            self._telemetry(packet)
        elif packet.type is PacketType.EVENT:
            self._event(packet, now_s)
        elif packet.type is PacketType.TRANSFER:
            service = self._dictionary.service_of_code("transfer", packet.code)
            if service is None:
                self._undecodable += 1
            else:
                self._desk.receive(service.name, packet.request_id, decode(service.fields, packet.payload), now_s)
        else:
            self._undecodable += 1

    def _report(self, packet: Packet, command: Command, now_s: float) -> None:
        sent = self._lane.record(packet.request_id)
        if sent is not None and sent.command.code != command.code:
            # Its values would be attributed to the command that was sent under this id.
            raise CorruptData("a report names another command", expected=sent.command.name, got=command.name)
        stage_reached, facts = read_report(packet, command, self._dictionary)
        stages = self._lane.report(packet.request_id, stage_reached, now_s, facts)
        self._repeated_ids += bool(facts["replayed"]) or not stages
        self._events += stages
        for stage in stages:
            if stage.stage is Stage.COMPLETED:
                self._completed(stage, packet, now_s)

    def _completed(self, stage: CommandStage, packet: Packet, now_s: float) -> None:
        if stage.name == "HELLO":
            self._identified(stage.values, packet.time_s, now_s)
        elif stage.name == "CONFIRM_BANK" and self._housekeeping is not None:
            record = self._lane.record(stage.request_id)
            if record is not None:
                self._desk.bank_in_use(record.payload[0])

    def _identified(self, v: Mapping[str, Value], device_time_s: float, now_s: float) -> None:
        before, hello = self._handshake.hello, self._handshake.met(v, device_time_s)
        if before is not None and before.serial != hello.serial:
            # Commands meant for one unit must never reach another.
            self._events += self._lane.abandon(f"meant for {before.serial}; {hello.serial} answered")
        self._desk.line_bytes_s = hello.line_baud / 10 if hello.line_baud else None
        # If the host's database was lost, ids that the device remembers must not be used again.
        self._ids.following = max(self._ids.following, hello.last_request_id % 0xFFFF_FFFF + 1)
        self._events.append(hello)
        if self._handshake.agreed:
            self._desk.line_back(now_s)

    def _telemetry(self, packet: Packet) -> None:
        telemetry = self._reader.read(packet)
        if telemetry is None:
            self._undecodable += 1
            return
        if telemetry.packet == "housekeeping":
            self._housekeeping = telemetry.values
        self._events.append(telemetry)

    def _event(self, packet: Packet, now_s: float) -> None:
        definition = self._dictionary.event_of_code(packet.code)
        if definition is None:
            self._undecodable += 1
            return
        self._events.append(read_event(packet, definition, self._dictionary))
        if definition.name == "BOOT":
            self._desk.device_restarted(now_s)
            self._handshake.ask_at(now_s)

    def _take_events(self, now_s: float) -> list[SessionEvent]:
        self._events += self._desk.news(now_s)
        events, self._events = self._events, []
        return events

    # --- state --------------------------------------------------------------------------------------------------

    @property
    def counters(self) -> LinkCounters:
        """Counters since the session was created."""
        return count_line(self._sender, self._receiver, self._undecodable, self._last_good_s, self._repeated_ids)

    @property
    def next_request_id(self) -> int:
        """Id that the next command or transfer opening takes; store it before a restart."""
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

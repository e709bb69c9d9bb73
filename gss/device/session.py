"""The ground's half of a contact, without any input or output: bytes and a clock in, bytes and events out.

``HostSession`` keeps commands (queue, windows, retries), transfers and counters. It owns no thread and no port: an owner
calls ``link_up`` when a port is open, ``feed`` with what arrived and ``poll`` often (10–50 ms) and writes what poll returns.
All times are ``now_s`` of the owner's monotonic clock. Not thread-safe: one owner, one lock.
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
    """One device on one line. See the module's text; methods raise BadInput, NotFound or Conflict and then change nothing."""

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
        """Queue a command and return its request id, a fresh one unless one was reserved. Missing arguments take their
        default.

        Commands wait until the device has introduced itself; only ABORT does not.
        BadInput "0 – 255, got 300" out of range; Conflict while the dictionaries differ and nobody acknowledged it.
        """
        self.check_allowed(name)
        if request_id is None:
            return self._add(name, arguments, urgent=False)
        self._events.append(self._lane.add(request_id, name, arguments))
        return request_id

    def reserve(self) -> int:
        """A request id for a later ``submit``: the owner can write it down before anything is queued."""
        return self._ids()

    def check_allowed(self, name: str) -> None:
        """Conflict while the dictionaries differ and nobody acknowledged it; NotFound without such a command."""
        self._handshake.check_allowed(name)

    def _add(self, name: str, arguments: Mapping[str, Value], *, urgent: bool) -> int:
        event = self._lane.add(self._ids.following, name, arguments, urgent=urgent)
        self._events.append(event)
        return self._ids()

    def preview(self, name: str, arguments: Mapping[str, Value]) -> list[tuple[str, bytes]]:
        """Dry run: the packet before framing as labelled groups; an argument's group has its name as label.

        The request id shown is the one the next submit would take.
        """
        return command_preview(self._dictionary, self._sender, self._ids.following, name, arguments)

    def retry(self, request_id: int, now_s: float) -> None:
        """Send the same bytes with the same id once more; Conflict unless the command is unknown."""
        self._events.append(self._lane.retry(request_id))

    def withdraw(self, request_id: int, detail: str) -> CommandStage:
        """Take a command back that waits in the queue; Conflict once it was released. The stage is not told again."""
        return self._lane.withdraw(request_id, detail)

    def withdraw_all(self, detail: str) -> list[CommandStage]:
        """The same for everything that waits in the queue."""
        return self._lane.clear(detail)

    def abort(self, now_s: float) -> int:
        """ABORT ahead of everything, never blocked. Returns its request id."""
        return self._add("ABORT", {}, urgent=True)

    def acknowledge_mismatch(self) -> None:
        """The operator accepts that the device has another dictionary; commands go out with the device's prefix."""
        self._handshake.acknowledge()

    def restore(self, next_request_id: int, in_flight: Sequence[InFlight], next_transfer_id: int = 1) -> None:
        """After a restart: seed the ids; (request id, name, arguments) come back as unknown and may be retried."""
        self._ids.following = next_request_id
        self._next_transfer_id = max(self._next_transfer_id, next_transfer_id)
        for request_id, name, arguments in in_flight:
            self._events.append(self._lane.add_unknown(request_id, name, arguments))

    def craft(
        self, kind: PacketType, code: int, payload: bytes, *, request_id: int | None = None, prefix: int | None = None
    ) -> tuple[int, bytes]:
        """Request id and frame of a packet of the owner's own making, which this session does not follow: for tests of the
        far end. The id is a fresh one unless given; the prefix is the dictionary's unless given."""
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
        """Queue a download of any kind the dictionary knows and return its transfer id.

        ``held``: what an earlier attempt left; only the rest is asked for if the content is still the same. ``part``: which
        region, or which side of star windows. ``chunk_bytes``: just this size, whatever the line does. ``paused``: wait, for
        this reason, until the device has introduced itself.
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
        """Queue an upload (to a bank's or slot's number); verify and commit follow by themselves.

        The same data to the same target after a break resumes with what the device still holds. ``paused``: as for downloads.
        """
        if not data:
            raise BadInput("nothing to upload", expected="at least 1 byte", got="0 bytes")
        size = self._chunk_size(kind, chunk_bytes, Direction.UP)
        transfer = Transfer(self._next_transfer_id, Direction.UP, kind, checked_target(target), size, compatibility)
        transfer.take_content(data)
        transfer.grid_is_fixed = chunk_bytes is not None
        return self._queue(transfer, paused)

    def _chunk_size(self, kind: str, wanted: int | None, direction: Direction) -> int:
        """The size of chunks for a kind of content that the dictionary knows."""
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
        """Stop sending; Conflict unless it is queued, opening, transferring or link_lost."""
        self._desk.pause(transfer_id)

    def resume_transfer(self, transfer_id: int, now_s: float) -> None:
        """Go on with a paused, link_lost or failed transfer."""
        self._desk.resume(transfer_id)

    def abort_transfer(self, transfer_id: int, now_s: float) -> None:
        """Give a transfer up on both sides; what was received stays readable with ``partial``."""
        self._desk.abort(transfer_id)

    def partial(self, transfer_id: int) -> tuple[bytes, Ranges]:
        """What a download holds: (size,) bytes with zeros where chunks miss, and the held chunk ranges."""
        transfer = self._desk.get(transfer_id)
        return bytes(transfer.data), transfer.stored()[0]

    def transfer(self, transfer_id: int) -> TransferUpdate:
        """The transfer as it stood at the last poll; NotFound otherwise."""
        return self._desk.get(transfer_id).update(self._pacer.polled_s or 0.0, self._desk.line_bytes_s)

    def forget_transfer(self, transfer_id: int) -> None:
        """Free the memory of a transfer that has ended."""
        self._desk.forget(transfer_id)

    # --- line ---------------------------------------------------------------------------------------------------

    def link_up(self, now_s: float) -> None:
        """The owner has a port (again): parsers start clean, HELLO goes out until it is answered, then transfers resume."""
        self._receiver.restart()
        self._up = True
        self._handshake.begin(now_s)
        self._pacer.restart(now_s)

    def link_lost(self, now_s: float) -> list[SessionEvent]:
        """The owner lost the port: commands under way become unknown, transfers link_lost."""
        self._up = False
        self._handshake.ask_at(None)
        self._desk.lose_line()
        self._events += self._lane.lose_all("The line was lost while the command was under way.")
        return self._take_events(now_s)

    def feed(self, data: bytes, now_s: float) -> list[SessionEvent]:
        """Take bytes from the line. Never raises, whatever they are."""
        for packet in self._receiver.feed(data):
            self._last_good_s = now_s
            try:
                self._dispatch(packet, now_s)
            except (CorruptData, BadInput):
                self._undecodable += 1
        return self._take_events(now_s)

    def poll(self, now_s: float) -> tuple[bytes, list[SessionEvent]]:
        """Bytes to write now, and what time alone brought (windows closed, transfers suspended, progress)."""
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

    # --- what came ----------------------------------------------------------------------------------------------

    def _dispatch(self, packet: Packet, now_s: float) -> None:
        command = self._dictionary.command_of_code(packet.code) if packet.type is PacketType.REPORT else None
        if command is not None:
            self._report(packet, command, now_s)
        elif packet.prefix != self._dictionary.prefix and not self._handshake.acknowledged:
            # Another dictionary's telemetry would decode to nonsense.
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
            # Its values would be taken for those of the command that was sent under this id.
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
            # What was meant for one unit must never reach another.
            self._events += self._lane.abandon(f"meant for {before.serial}; {hello.serial} answered")
        self._desk.line_bytes_s = hello.line_baud / 10 if hello.line_baud else None
        # A ground without its old database must not use ids again that the device remembers.
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
        """Counters since the session was made."""
        return count_line(self._sender, self._receiver, self._undecodable, self._last_good_s, self._repeated_ids)

    @property
    def next_request_id(self) -> int:
        """The id that the next command or opening takes; store it before a restart."""
        return self._ids.following

    @property
    def housekeeping(self) -> Mapping[str, Value] | None:
        """Latest housekeeping in engineering units, for preconditions."""
        return self._housekeeping

    @property
    def hello(self) -> HelloReceived | None:
        """The last identity the device gave."""
        return self._handshake.hello

    @property
    def device_dictionary_hash(self) -> str | None:
        """As the last HELLO said."""
        return self.hello.dictionary_hash if self.hello else None

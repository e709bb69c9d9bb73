"""Probe of a device for ``gss check device``. It sends commands and messages without the host's checks and collects all
responses."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field

from gss.device.protocol.authentication import PacketSigner
from gss.device.protocol.codec import Decoded, decode, encode
from gss.device.protocol.packet import Packet, PacketType
from gss.device.protocol.receiver import LineReceiver
from gss.device.session import HostSession
from gss.device.transport import ByteStream, open_stream
from gss.domain.errors import Conflict, CorruptData
from gss.instruments.dictionary.definitions import CommandDefinition, Dictionary, Value
from gss.instruments.roles import default_roles
from gss.operations.checks.direct import DirectDevice
from gss.operations.clock import Monotonic

FINAL = ("rejected", "completed", "failed")
UNREADABLE = "unreadable"
"""Stage of a report that does not fit its layout."""
QUIET_S = 0.7
"""If the line is idle and no answer arrives within this time, the device is assumed not to answer."""


class Tap:
    """A line that records the received packets. Chunks are not recorded because there are too many."""

    def __init__(self, stream: ByteStream, chunk_code: int) -> None:
        self._stream, self._chunk_code, self.url = stream, chunk_code, stream.url
        self.receiver = LineReceiver(from_device=True)
        self.packets: list[Packet] = []

    def read(self, max_bytes: int, timeout_s: float) -> bytes:
        """Read bytes as :class:`ByteStream` does, and record the received packets."""
        data = self._stream.read(max_bytes, timeout_s)
        received = self.receiver.feed(data)
        self.packets += [p for p in received if p.type is not PacketType.TRANSFER or p.code != self._chunk_code]
        return data

    def write(self, data: bytes) -> None:
        """See :class:`ByteStream`."""
        self._stream.write(data)

    def close(self) -> None:
        """See :class:`ByteStream`."""
        self._stream.close()


@dataclass(frozen=True)
class ReceivedReport:
    """A received report. ``after_s``: seconds since the previous report, or since the command was sent."""

    stage: str
    reason: str
    detail: str
    replayed: bool
    code: int
    values: Mapping[str, Value]
    after_s: float


@dataclass(frozen=True)
class CommandOutcome:
    """Everything received for a command until its final report or timeout."""

    request_id: int
    reports: tuple[ReceivedReport, ...] = ()
    packets: tuple[Packet, ...] = field(default=(), repr=False)

    @property
    def accepted(self) -> bool:
        """True if the command was accepted."""
        return any(r.stage == "accepted" for r in self.reports)

    @property
    def last(self) -> ReceivedReport | None:
        """The last report received, None if there is none."""
        return self.reports[-1] if self.reports else None

    @property
    def text(self) -> str:
        """The stages and reasons of the reports as one line of text."""
        parts = [f"{r.stage} ({r.reason})" if r.reason != "none" else r.stage for r in self.reports]
        return ", ".join(parts) or "no report"

    def is_(self, stage: str, reason: str = "none") -> bool:
        """True if the last report has this stage and reason."""
        return self.last is not None and (self.last.stage, self.last.reason) == (stage, reason)


class Probe:
    """A device and a tap on its line. ``monotonic_s``: monotonic clock of the host."""

    def __init__(
        self, stream: ByteStream, dictionary: Dictionary, monotonic_s: Monotonic, signer: PacketSigner | None = None
    ) -> None:
        self.dictionary, self._now_s = dictionary, monotonic_s
        self.operations = default_roles(dictionary).operations
        self.tap = Tap(stream, dictionary.service("CHUNK").code)
        self._session = HostSession(dictionary, signer=signer)
        self.device = DirectDevice(self.tap, self._session, dictionary, monotonic_s)

    # --- bytes and packets --------------------------------------------------------------------------------------

    def write(self, data: bytes) -> None:
        """Write bytes unchanged."""
        self.tap.write(data)

    def send(
        self, kind: PacketType, code: int, payload: bytes, *, request_id: int | None = None, prefix: int | None = None
    ) -> int:
        """Send a packet built by the caller, without any checks. Return its request id."""
        sent_id, frame = self._session.craft(kind, code, payload, request_id=request_id, prefix=prefix)
        self.tap.write(frame)
        return sent_id

    def wait(self, done: Callable[[Packet], bool], within_s: float) -> list[Packet]:
        """Return the packets received until ``done`` is True for a packet or until the timeout. If ``done`` was True
        for a packet, this packet is the last in the list."""
        return self._collect(len(self.tap.packets), done, within_s)

    def _collect(self, start: int, done: Callable[[Packet], bool], within_s: float) -> list[Packet]:
        position, deadline_s = start, self._now_s() + within_s
        while True:
            for at in range(position, len(self.tap.packets)):
                if done(self.tap.packets[at]):
                    return self.tap.packets[start : at + 1]
            position = len(self.tap.packets)
            if self._now_s() >= deadline_s:
                return self.tap.packets[start:]
            self.device.turn()

    # --- commands -----------------------------------------------------------------------------------------------

    def order(
        self, name: str, arguments: Mapping[str, Value] | None = None, *, request_id: int | None = None
    ) -> CommandOutcome:
        """Send a command by name without the host's range checks and return its outcome. Missing arguments have their default
        values."""
        command = self.dictionary.command(name)
        return self.raw(command.code, self.payload(command, arguments or {}), command=command, request_id=request_id)

    def payload(self, command: CommandDefinition, arguments: Mapping[str, Value]) -> bytes:
        """Encode a command's arguments."""
        defaults = {a.name: a.default for a in command.arguments if a.default is not None}
        return encode(command.arguments, defaults | dict(arguments))

    def raw(
        self,
        code: int,
        payload: bytes,
        *,
        command: CommandDefinition | None = None,
        request_id: int | None = None,
        prefix: int | None = None,
    ) -> CommandOutcome:
        """Send a command packet and collect the response. ``command`` defines the timeouts."""
        accept_s, complete_s = (command.accept_s, command.complete_s) if command else (2.0, 2.0)
        start, before_s = len(self.tap.packets), self._now_s()
        sent_id = self.send(PacketType.COMMAND, code, payload, request_id=request_id, prefix=prefix)
        reports: list[ReceivedReport] = []
        window_s = accept_s
        while not reports or reports[-1].stage not in (*FINAL, UNREADABLE):
            at = len(self.tap.packets) if reports else start
            received = self._collect(max(at, start), lambda p: self._reports_on(p, sent_id), window_s)
            if not received or not self._reports_on(received[-1], sent_id):
                break
            # Several reports can arrive in one read, so all new reports are processed in order.
            new_reports = [p for p in self.tap.packets[start:] if self._reports_on(p, sent_id)][len(reports) :]
            now_s = self._now_s()
            for packet in new_reports:
                reports.append(self._report(packet, now_s - before_s))
                before_s = now_s
            window_s = complete_s
        return CommandOutcome(sent_id, tuple(reports), tuple(self.tap.packets[start:]))

    @staticmethod
    def _reports_on(packet: Packet, request_id: int) -> bool:
        return packet.type is PacketType.REPORT and packet.request_id == request_id

    def _report(self, packet: Packet, after_s: float) -> ReceivedReport:
        fields, command = self.dictionary.service("REPORT").fields, self.dictionary.command_of_code(packet.code)
        done = packet.payload[:1] == encode([fields[0]], {"stage": "completed"})  # type: ignore[list-item]  # an item of a service is an Item
        returns = command.returns if done and command else ()
        try:
            reported = decode((*fields, *returns), packet.payload).values
        except CorruptData as error:
            return ReceivedReport(UNREADABLE, "none", str(error), False, packet.code, {}, after_s)
        values = {item.name: reported[item.name] for item in returns}
        stage, reason, detail = str(reported["stage"]), str(reported["reason"]), str(reported["detail"])
        return ReceivedReport(stage, reason, detail, bool(reported["replayed"]), packet.code, values, after_s)

    def reports(self, request_id: int, start: int) -> list[ReceivedReport]:
        """Return the reports on a request in the packets from index ``start``. Their ``after_s`` is 0 because it is unknown."""
        matching = [p for p in self.tap.packets[start:] if self._reports_on(p, request_id)]
        return [self._report(p, 0.0) for p in matching]

    # --- reports from the device --------------------------------------------------------------------------------

    def telemetry(self, packets: tuple[Packet, ...] | list[Packet], name: str) -> list[Decoded]:
        """Return the decoded telemetry packets with this name. Raises CorruptData if a packet does not match its layout."""
        row = self.dictionary.packet(name)
        matching = [p for p in packets if p.type is PacketType.TELEMETRY and p.code == row.code]
        return [decode(row.fields, p.payload) for p in matching]

    def status(self) -> Mapping[str, Value]:
        """Return the current housekeeping in engineering units. Raises Conflict if no housekeeping packet arrives."""
        answer = self.order("GET_STATUS")
        received = self.telemetry([p for p in answer.packets if p.request_id == answer.request_id], "housekeeping")
        if not received:
            raise Conflict("GET_STATUS returned no housekeeping", got=answer.text)
        return received[-1].values

    def banks(self) -> list[Mapping[str, Value]]:
        """Return the rows reported by LIST_BANKS."""
        answer = self.order("LIST_BANKS")
        return [b.values for b in self.telemetry(answer.packets, "bank_info")]

    def transfer(self, service: str, values: Mapping[str, Value], request_id: int | None = None) -> int:
        """Send a transfer message and return its request id."""
        row = self.dictionary.service(service)
        return self.send(PacketType.TRANSFER, row.code, encode(row.fields, values), request_id=request_id)

    def transfer_reply(self, request_id: int, within_s: float = 3.0) -> tuple[str, Mapping[str, Value]]:
        """Return the name and values of the next OPENED or ABORT_TRANSFER for a request. The name is "" if no reply arrives."""
        codes = {self.dictionary.service(name).code: name for name in ("OPENED", "ABORT_TRANSFER")}

        def fits(packet: Packet) -> bool:
            return packet.type is PacketType.TRANSFER and packet.request_id == request_id and packet.code in codes

        received = self.wait(fits, within_s)
        if not received or not fits(received[-1]):
            return "", {}
        name = codes[received[-1].code]
        return name, decode(self.dictionary.service(name).fields, received[-1].payload).values


@contextmanager
def probing(
    url: str, dictionary: Dictionary, monotonic_s: Monotonic, signer: PacketSigner | None = None
) -> Iterator[Probe]:
    """Open a probe on a port and wait until the device has answered."""
    stream = open_stream(url)
    try:
        yield Probe(stream, dictionary, monotonic_s, signer)
    finally:
        stream.close()

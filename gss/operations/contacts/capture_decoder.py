"""Decoder of raw captures. The decoder uses the receivers and readers of the live line, but has no session state.

Bytes sent by the ground are also decoded, so a replay shows commands with their names and arguments.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

from gss.device.protocol.codec import decode
from gss.device.protocol.packet import Packet, PacketType
from gss.device.protocol.receiver import LineReceiver
from gss.device.session_counters import count_line
from gss.device.session_events import DeviceEvent, DirectionCounters, HelloReceived, Stage, Telemetry
from gss.device.session_reading import read_event, read_hello, read_report
from gss.device.session_telemetry import TelemetryReader
from gss.domain.errors import BadInput, CorruptData
from gss.instruments.dictionary.definitions import Dictionary
from gss.operations.line.raw_capture import SENT, Record


@dataclass(frozen=True)
class CommandSaid:
    """A sent command (stage "sent", with its arguments in ``values``) or a report on a command."""

    request_id: int
    name: str
    stage: str
    values: Mapping[str, Any] = field(default_factory=dict)
    detail: str = ""


Item = Telemetry | DeviceEvent | HelloReceived | CommandSaid


@dataclass(frozen=True)
class Replayed:
    """A decoded item. ``at_s``: time at which its last byte was received or sent, Unix seconds."""

    at_s: float
    item: Item


class CaptureDecoder:
    """Decodes the records of one contact, which must be fed in order. Packets that cannot be decoded are counted; they
    do not raise an exception.

    ``foreign``: number of packets of a device with another dictionary; these packets are not decoded.
    ``transfer_packets``: number of transfer packets, which are not decoded.
    """

    def __init__(self, dictionary: Dictionary, framing: str = "cobs") -> None:
        self._dictionary, self._reader = dictionary, TelemetryReader(dictionary)
        self._down = LineReceiver(from_device=True, framing=framing)
        self._up = LineReceiver(from_device=False, framing=framing)
        self.foreign = self.undecodable = self.transfer_packets = 0

    def feed(self, at_s: float, direction: int, data: bytes) -> list[Replayed]:
        """Decode a record and return the items that it completes."""
        receiver = self._up if direction == SENT else self._down
        decoded: list[Replayed] = []
        for packet in receiver.feed(data):
            try:
                items = self._read(packet)
            except (CorruptData, BadInput):
                self.undecodable += 1
                continue
            if items is not None:
                decoded += [Replayed(at_s, item) for item in items]
        return decoded

    def _read(self, packet: Packet) -> list[Item] | None:
        if packet.type is PacketType.TRANSFER:
            self.transfer_packets += 1
            return None
        # Reports and commands have the same codes in all dictionaries. The report on HELLO identifies the other dictionary.
        if (
            packet.type not in (PacketType.REPORT, PacketType.COMMAND)
            and packet.prefix not in self._dictionary.prefixes
        ):
            self.foreign += 1
            return None
        return {
            PacketType.COMMAND: self._command,
            PacketType.REPORT: self._report,
            PacketType.TELEMETRY: self._telemetry,
            PacketType.EVENT: self._event,
        }[packet.type](packet)

    def _command(self, packet: Packet) -> list[Item]:
        command = self._dictionary.command_of_code(packet.code)
        if command is None:
            raise CorruptData("unknown command code", got=str(packet.code))
        values = decode(command.arguments, packet.payload).values
        return [CommandSaid(packet.request_id, command.name, "sent", values)]

    def _report(self, packet: Packet) -> list[Item]:
        command = self._dictionary.command_of_code(packet.code)
        if command is None:
            raise CorruptData("unknown command code", got=str(packet.code))
        stage, facts = read_report(packet, command, self._dictionary)
        detail = " ".join(word for word in (facts["reason"], facts["detail"]) if word)
        items: list[Item] = [CommandSaid(packet.request_id, command.name, stage.value, facts["values"], detail)]
        if command.name == "HELLO" and stage is Stage.COMPLETED:
            self._down.sequence.hello(packet.time_s)
            items.append(read_hello(facts["values"], packet.time_s, self._dictionary))
        return items

    def _telemetry(self, packet: Packet) -> list[Item]:
        telemetry = self._reader.read(packet)
        if telemetry is None:
            raise CorruptData("unknown telemetry code", got=str(packet.code))
        return [telemetry]

    def _event(self, packet: Packet) -> list[Item]:
        definition = self._dictionary.event_of_code(packet.code)
        if definition is None:
            raise CorruptData("unknown event code", got=str(packet.code))
        return [read_event(packet, definition, self._dictionary)]

    @property
    def damaged(self) -> int:
        """Number of damaged packets received."""
        return self._down.bad_total

    @property
    def received(self) -> DirectionCounters:
        """Receive counters, calculated by the same function as on the live line."""
        from gss.device.protocol.sender import LineSender

        unused = LineSender(to_device=True, prefix=self._dictionary.prefix)
        return count_line(unused, self._down, self.undecodable + self.foreign, None).received


def decoded(records: Iterable[Record], decoder: CaptureDecoder) -> Iterator[Replayed]:
    """Yield all items decoded from the records, in order."""
    for at_s, direction, data in records:
        yield from decoder.feed(at_s, direction, data)

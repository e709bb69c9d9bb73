"""One end of the line: packets to frames with sequence counts, frames to packets with counters. Used by host and device."""

from __future__ import annotations

from collections import Counter

from gss.device.protocol.frame import MAX_PACKET_BYTES, Deframer, encode_frame, framing_named
from gss.device.protocol.packet import SEQUENCE_MODULO, Damage, Packet, PacketType, decode_packet, encode_packet


class LineSender:
    """Numbers and frames packets. ``bytes`` and ``good`` count the frames produced."""

    def __init__(self, *, to_device: bool, prefix: int, framing: str = "cobs") -> None:
        framing_named(framing)
        self.prefix, self._framing = prefix, framing
        self._to_device = to_device
        self._sequence: Counter[PacketType] = Counter()
        self.bytes = self.good = 0

    def packet(self, kind: PacketType, code: int, request_id: int, payload: bytes, time_s: float = 0.0) -> bytes:
        """Return the next packet of its type as a frame."""
        sequence = self._sequence[kind]
        self._sequence[kind] = (sequence + 1) % SEQUENCE_MODULO
        packet = Packet(kind, code, request_id, payload, self.prefix, self._to_device, sequence, time_s)
        frame = encode_frame(encode_packet(packet), self._framing)
        self.bytes += len(frame)
        self.good += 1
        return frame

    def next_packet(self, kind: PacketType, code: int, request_id: int, payload: bytes) -> bytes:
        """Return the next packet of its type unframed, without using up its sequence count (dry run)."""
        packet = Packet(kind, code, request_id, payload, self.prefix, self._to_device, self._sequence[kind])
        return encode_packet(packet)


class LineReceiver:
    """Converts bytes to packets.

    Counters: good, bad_crc, too_short, unknown (APID, type or direction), gaps, duplicates, and those of the Deframer.
    """

    def __init__(self, *, from_device: bool, max_packet_bytes: int = MAX_PACKET_BYTES, framing: str = "cobs") -> None:
        self.deframer = Deframer(max_packet_bytes, framing)
        self._to_device = not from_device
        self._expected: dict[PacketType, int] = {}
        self.good = self.bad_crc = self.too_short = self.unknown = self.gaps = self.duplicates = 0

    def restart(self) -> None:
        """Start a new stream: accept any next sequence count."""
        self.deframer.restart()
        self._expected.clear()

    def feed(self, data: bytes) -> list[Packet]:
        """Return the intact packets addressed to this end, in order."""
        packets = []
        for frame in self.deframer.feed(data):
            packet = decode_packet(frame)
            if isinstance(packet, Damage):
                self._count(packet)
            elif packet.to_device != self._to_device:
                self.unknown += 1
            else:
                self.good += 1
                self._follow(packet)
                packets.append(packet)
        return packets

    def _count(self, damage: Damage) -> None:
        if damage is Damage.TOO_SHORT:
            self.too_short += 1
        elif damage is Damage.BAD_CRC:
            self.bad_crc += 1
        else:
            self.unknown += 1

    def _follow(self, packet: Packet) -> None:
        """Compare the sequence count with the expected one: the previous number again is a duplicate, a jump is a gap."""
        expected = self._expected.get(packet.type)
        if expected is not None and packet.sequence != expected:
            if (packet.sequence + 1) % SEQUENCE_MODULO == expected:
                self.duplicates += 1
            else:
                self.gaps += (packet.sequence - expected) % SEQUENCE_MODULO
        self._expected[packet.type] = (packet.sequence + 1) % SEQUENCE_MODULO

    @property
    def bad_total(self) -> int:
        """Number of received frames that could not be used."""
        return self.bad_crc + self.too_short + self.deframer.too_long + self.deframer.broken

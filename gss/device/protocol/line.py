"""One end of the line: packets to frames with sequence counts, frames to packets with counters. Used by both ends."""

from __future__ import annotations

from collections import Counter

from gss.device.protocol.frame import MAX_PACKET_BYTES, Deframer, encode_frame, framing_named
from gss.device.protocol.packet import SEQUENCE_MODULO, Damage, Packet, PacketType, decode_packet, encode_packet


class LineSender:
    """Numbers and frames packets. ``bytes`` and ``good`` count what was made."""

    def __init__(self, *, to_device: bool, prefix: int, framing: str = "cobs") -> None:
        framing_named(framing)
        self.prefix, self._framing = prefix, framing
        self._to_device = to_device
        self._sequence: Counter[PacketType] = Counter()
        self.bytes = self.good = 0

    def packet(self, kind: PacketType, code: int, request_id: int, payload: bytes, time_s: float = 0.0) -> bytes:
        """The next packet of its kind, framed."""
        sequence = self._sequence[kind]
        self._sequence[kind] = (sequence + 1) % SEQUENCE_MODULO
        packet = Packet(kind, code, request_id, payload, self.prefix, self._to_device, sequence, time_s)
        frame = encode_frame(encode_packet(packet), self._framing)
        self.bytes += len(frame)
        self.good += 1
        return frame

    def next_packet(self, kind: PacketType, code: int, request_id: int, payload: bytes) -> bytes:
        """The same without framing and without using up a number: the dry run."""
        packet = Packet(kind, code, request_id, payload, self.prefix, self._to_device, self._sequence[kind])
        return encode_packet(packet)


class LineReceiver:
    """Bytes to packets. Counters: good, bad_crc, too_short, unknown (APID, type or direction), gaps, duplicates, and the
    Deframer's."""

    def __init__(self, *, from_device: bool, max_packet_bytes: int = MAX_PACKET_BYTES, framing: str = "cobs") -> None:
        self.deframer = Deframer(max_packet_bytes, framing)
        self._to_device = not from_device
        self._expected: dict[PacketType, int] = {}
        self.good = self.bad_crc = self.too_short = self.unknown = self.gaps = self.duplicates = 0

    def restart(self) -> None:
        """A new stream: the next sequence counts are taken as they come."""
        self.deframer.restart()
        self._expected.clear()

    def feed(self, data: bytes) -> list[Packet]:
        """Intact packets for this end, in order."""
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
        """Count what the sequence says is missing. The same number twice is a duplicate, a jump is a gap."""
        expected = self._expected.get(packet.type)
        if expected is not None and packet.sequence != expected:
            if (packet.sequence + 1) % SEQUENCE_MODULO == expected:
                self.duplicates += 1
            else:
                self.gaps += (packet.sequence - expected) % SEQUENCE_MODULO
        self._expected[packet.type] = (packet.sequence + 1) % SEQUENCE_MODULO

    @property
    def bad_total(self) -> int:
        """Frames that came and could not be used."""
        return self.bad_crc + self.too_short + self.deframer.too_long + self.deframer.broken

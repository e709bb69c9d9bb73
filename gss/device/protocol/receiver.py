"""Convert bytes from the line to packets: split into frames, verify, and evaluate sequence counts. Used by host and
device."""

from __future__ import annotations

import zlib
from dataclasses import replace
from enum import Enum

from gss.device.protocol.authentication import PacketVerifier
from gss.device.protocol.framing import MAX_PACKET_BYTES, BrokenFrame, framing_named
from gss.device.protocol.packet import (
    APID_BASE,
    CRC_BYTES,
    KINDS,
    OVERHEAD_BYTES,
    PRIMARY,
    SECONDARY,
    SECONDARY_FLAG,
    SIGNED_APID_BASE,
    TO_DEVICE,
    TRAILER_BYTES,
    Packet,
)
from gss.device.protocol.sequence_counts import SequenceTracker


class Damage(Enum):
    """Reasons why bytes are not a valid packet."""

    TOO_SHORT = "too_short"
    BAD_CRC = "bad_crc"
    UNKNOWN = "unknown"


class LineReceiver:
    """Converts bytes to packets. With a ``verifier``, packets without a valid authentication trailer are dropped.

    Counters: good, bad_crc, too_short, unknown (APID, type or direction), unauthenticated; the counters of the
    Deframer; gaps and duplicates in ``sequence``.
    """

    def __init__(
        self,
        *,
        from_device: bool,
        max_packet_bytes: int = MAX_PACKET_BYTES,
        framing: str = "cobs",
        verifier: PacketVerifier | None = None,
    ) -> None:
        self._verifier = verifier
        self.deframer = Deframer(max_packet_bytes, framing)
        self._to_device = not from_device
        self.sequence = SequenceTracker()
        self.good = self.bad_crc = self.too_short = self.unknown = self.unauthenticated = 0

    def restart(self) -> None:
        """Start a new stream: accept any next sequence count, but reject packets that are older than the packets of the
        previous stream."""
        self.deframer.restart()
        self.sequence.reopen()

    def feed(self, data: bytes) -> list[Packet]:
        """Return the intact packets addressed to this end, in order."""
        packets = []
        for frame in self.deframer.feed(data):
            packet = decode_packet(frame)
            if isinstance(packet, Damage):
                self._count(packet)
            elif packet.to_device != self._to_device:
                self.unknown += 1
            elif self._verifier is not None and not (packet.signed and self._verifier.accepts(frame)):
                self.unauthenticated += 1
            else:
                self.good += 1
                arrival = self.sequence.arrival(packet)
                packets.append(packet if arrival is packet.arrival else replace(packet, arrival=arrival))
        return packets

    def _count(self, damage: Damage) -> None:
        if damage is Damage.TOO_SHORT:
            self.too_short += 1
        elif damage is Damage.BAD_CRC:
            self.bad_crc += 1
        else:
            self.unknown += 1

    @property
    def bad_total(self) -> int:
        """Number of received frames that could not be used."""
        damaged = self.bad_crc + self.too_short + self.deframer.too_long + self.deframer.broken
        return damaged + self.unauthenticated


class Deframer:
    """Splits a byte stream into packets. Buffers at most one frame of maximum length; never raises.

    Counters: ``bytes`` received in total, ``unframed`` bytes before the first delimiter, ``too_long`` and ``broken``
    frames.
    """

    def __init__(self, max_packet_bytes: int = MAX_PACKET_BYTES, framing: str = "cobs") -> None:
        self._how, self._longest = framing_named(framing), max_packet_bytes
        self._limit = self._how.limit(max_packet_bytes)
        self._buffer = bytearray()
        self._overflow = False
        self._synced = False
        self.bytes = self.unframed = self.too_long = self.broken = 0

    def restart(self) -> None:
        """Start a new stream: discard the partial frame and wait for a delimiter. The counters do not change."""
        self._buffer.clear()
        self._overflow = self._synced = False

    @property
    def held_bytes(self) -> int:
        """Bytes in the buffer, at most one frame of maximum length."""
        return len(self._buffer)

    def feed(self, data: bytes) -> list[bytes]:
        """Return the packets that ``data`` completes. Empty frames between adjacent delimiters are ignored."""
        self.bytes += len(data)
        pieces = data.split(self._how.delimiter)
        packets = []
        for piece in pieces[:-1]:
            self._append(piece)
            packet = self._close()
            if packet is not None:
                packets.append(packet)
        self._append(pieces[-1])
        return packets

    def _append(self, piece: bytes) -> None:
        if not self._synced:
            self.unframed += len(piece)
        elif self._overflow or len(self._buffer) + len(piece) > self._limit:
            self._overflow = True
            self._buffer.clear()
        else:
            self._buffer += piece

    def _close(self) -> bytes | None:
        """Decode the buffered frame at a delimiter. Returns None if it is empty or invalid."""
        self._synced = True
        if self._overflow:
            self._overflow = False
            self.too_long += 1
            return None
        if not self._buffer:
            return None
        try:
            packet = self._how.decode(bytes(self._buffer))
        except BrokenFrame:
            self.broken += 1
            return None
        finally:
            self._buffer.clear()
        if len(packet) > self._longest:
            self.too_long += 1
            return None
        return packet


def decode_packet(data: bytes) -> Packet | Damage:
    """Return the packet, or the reason why the bytes are not valid. Never raises."""
    if len(data) < OVERHEAD_BYTES:
        return Damage.TOO_SHORT
    if zlib.crc32(data[:-CRC_BYTES]) != int.from_bytes(data[-CRC_BYTES:], "big"):
        return Damage.BAD_CRC
    identification, sequence, length = PRIMARY.unpack_from(data)
    if length + 1 != len(data) - PRIMARY.size:
        return Damage.TOO_SHORT
    kind, code, prefix, request_id, seconds, ms = SECONDARY.unpack_from(data, PRIMARY.size)
    packet_kind, apid = KINDS.get(kind), (identification & ~TO_DEVICE) ^ SECONDARY_FLAG
    signed = apid == SIGNED_APID_BASE + kind
    if packet_kind is None or not (signed or apid == APID_BASE + kind) or ms > 999:
        return Damage.UNKNOWN
    end = len(data) - CRC_BYTES - (TRAILER_BYTES if signed else 0)
    if end < PRIMARY.size + SECONDARY.size:
        return Damage.TOO_SHORT
    return Packet(
        packet_kind,
        code,
        request_id,
        data[PRIMARY.size + SECONDARY.size : end],
        prefix,
        bool(identification & TO_DEVICE),
        sequence & 0x3FFF,
        seconds + ms / 1000,
        signed=signed,
    )

"""Convert packets to bytes for the line: number, encode and frame them. Used by host and device."""

from __future__ import annotations

import zlib
from collections import Counter

from gss.device.protocol.authentication import PacketSigner
from gss.device.protocol.framing import framing_named
from gss.device.protocol.packet import (
    APID_BASE,
    CRC_BYTES,
    MAX_TIME_S,
    PRIMARY,
    SECONDARY,
    SECONDARY_FLAG,
    SEQUENCE_MODULO,
    SIGNED_APID_BASE,
    TO_DEVICE,
    TRAILER_BYTES,
    Packet,
    PacketType,
)


class LineSender:
    """Numbers and frames packets. ``bytes``, ``good``: number of bytes and of frames produced."""

    def __init__(
        self, *, to_device: bool, prefix: int, framing: str = "cobs", signer: PacketSigner | None = None
    ) -> None:
        framing_named(framing)
        self.prefix, self._framing, self._signer = prefix, framing, signer
        self._to_device = to_device
        self._sequence: Counter[PacketType] = Counter()
        self.bytes = self.good = 0

    def packet(
        self,
        kind: PacketType,
        code: int,
        request_id: int,
        payload: bytes,
        time_s: float = 0.0,
        *,
        prefix: int | None = None,
    ) -> bytes:
        """Return the next packet of a type as a frame. ``prefix``: dictionary prefix of this packet, by default the
        sender's."""
        sequence = self._sequence[kind]
        self._sequence[kind] = (sequence + 1) % SEQUENCE_MODULO
        prefix = self.prefix if prefix is None else prefix
        packet = Packet(kind, code, request_id, payload, prefix, self._to_device, sequence, time_s)
        frame = encode_frame(encode_packet(packet, self._signer), self._framing)
        self.bytes += len(frame)
        self.good += 1
        return frame

    def next_packet(self, kind: PacketType, code: int, request_id: int, payload: bytes) -> bytes:
        """Return the next packet of a type, unframed and without authentication trailer (dry run). The sequence count
        is not used up."""
        packet = Packet(kind, code, request_id, payload, self.prefix, self._to_device, self._sequence[kind])
        return encode_packet(packet)


def encode_frame(packet: bytes, framing: str = "cobs") -> bytes:
    """Return the frame of a packet, with both delimiters."""
    frame_format = framing_named(framing)
    return frame_format.delimiter + frame_format.encode(packet) + frame_format.delimiter


def encode_packet(packet: Packet, signer: PacketSigner | None = None) -> bytes:
    """Return the bytes of a packet, including its trailer if there is a signer, and its CRC."""
    body = _secondary(packet) + packet.payload
    extra = CRC_BYTES + (TRAILER_BYTES if signer else 0)
    apid = (SIGNED_APID_BASE if signer else APID_BASE) + packet.type
    identification = (TO_DEVICE if packet.to_device else 0) | SECONDARY_FLAG | apid
    primary = PRIMARY.pack(identification, (3 << 14) | (packet.sequence % SEQUENCE_MODULO), len(body) + extra - 1)
    signed = primary + body
    return with_crc(signed + signer.trailer(signed) if signer else signed)


def _secondary(packet: Packet) -> bytes:
    total_ms = round(min(max(packet.time_s, 0.0), MAX_TIME_S) * 1000)
    seconds, ms = divmod(total_ms, 1000)
    return SECONDARY.pack(packet.type, packet.code, packet.prefix, packet.request_id, min(seconds, 0xFFFF_FFFF), ms)


def with_crc(data: bytes) -> bytes:
    """Return the data followed by its CRC-32."""
    return data + zlib.crc32(data).to_bytes(CRC_BYTES, "big")

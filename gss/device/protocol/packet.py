"""Packets: CCSDS primary header, secondary header of this protocol, payload, CRC-32.

Primary header (CCSDS 133.0-B-2 §4.1.3, 6 bytes): version 0, type 1 to the device and 0 from it, secondary header flag
1, APID by packet type, sequence flags 3, sequence count per APID and direction modulo 2¹⁴, number of bytes that follow
− 1.

Secondary header (14 bytes, big-endian): u8 packet type; u8 code; u16 first two bytes of the dictionary hash; u32
request id, 0 = unsolicited; u32 + u16 device time in seconds and milliseconds since the device's epoch, 0 from ground.

CRC-32 (``zlib.crc32``) over everything before it, last four bytes.
"""

from __future__ import annotations

import struct
import zlib
from dataclasses import dataclass
from enum import Enum, IntEnum

PRIMARY = struct.Struct(">HHH")
SECONDARY = struct.Struct(">BBHIIH")
CRC_BYTES = 4
OVERHEAD_BYTES = PRIMARY.size + SECONDARY.size + CRC_BYTES
APID_BASE = 0x100
TO_DEVICE, SECONDARY_FLAG = 1 << 12, 1 << 11
SEQUENCE_MODULO = 1 << 14
MAX_TIME_S = float(0xFFFF_FFFF)


class PacketType(IntEnum):
    """Packet types. The APID is APID_BASE plus the type."""

    COMMAND = 1
    REPORT = 2
    TELEMETRY = 3
    EVENT = 4
    TRANSFER = 5


KINDS: dict[int, PacketType] = {kind.value: kind for kind in PacketType}


class Damage(Enum):
    """Reasons why bytes are not a valid packet."""

    TOO_SHORT = "too_short"
    BAD_CRC = "bad_crc"
    UNKNOWN = "unknown"


@dataclass(frozen=True)
class Packet:
    """One packet, decoded down to its payload.

    ``to_device``: direction bit. ``prefix``: first two bytes of the sender's dictionary hash.
    """

    type: PacketType
    code: int
    request_id: int
    payload: bytes
    prefix: int
    to_device: bool
    sequence: int = 0
    time_s: float = 0.0


def encode_packet(packet: Packet) -> bytes:
    """Return the bytes of a packet, including its CRC."""
    body = _secondary(packet) + packet.payload
    identification = (TO_DEVICE if packet.to_device else 0) | SECONDARY_FLAG | (APID_BASE + packet.type)
    primary = PRIMARY.pack(identification, (3 << 14) | (packet.sequence % SEQUENCE_MODULO), len(body) + CRC_BYTES - 1)
    return with_crc(primary + body)


def _secondary(packet: Packet) -> bytes:
    total_ms = round(min(max(packet.time_s, 0.0), MAX_TIME_S) * 1000)
    seconds, ms = divmod(total_ms, 1000)
    return SECONDARY.pack(packet.type, packet.code, packet.prefix, packet.request_id, min(seconds, 0xFFFF_FFFF), ms)


def with_crc(data: bytes) -> bytes:
    """Return the data followed by its CRC-32."""
    return data + zlib.crc32(data).to_bytes(CRC_BYTES, "big")


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
    known = KINDS.get(kind)
    if known is None or identification & ~TO_DEVICE != SECONDARY_FLAG | (APID_BASE + kind) or ms > 999:
        return Damage.UNKNOWN
    return Packet(
        known,
        code,
        request_id,
        data[PRIMARY.size + SECONDARY.size : -CRC_BYTES],
        prefix,
        bool(identification & TO_DEVICE),
        sequence & 0x3FFF,
        seconds + ms / 1000,
    )


def labelled_bytes(data: bytes) -> list[tuple[str, bytes]]:
    """Return the header fields of an encoded packet as labelled bytes, in order, without payload and CRC (for the console)."""
    cuts = [
        ("APID", 2),
        ("sequence", 2),
        ("length", 2),
        ("type", 1),
        ("code", 1),
        ("dictionary", 2),
        ("request id", 4),
        ("time", 6),
    ]
    groups, at = [], 0
    for label, size in cuts:
        groups.append((label, data[at : at + size]))
        at += size
    return groups

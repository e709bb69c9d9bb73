"""Packets: CCSDS primary header, secondary header of this protocol, payload, CRC-32.

Primary header (CCSDS 133.0-B-2 §4.1.3, 6 bytes): version 0, type 1 to the device and 0 from it, secondary header flag
1, APID by packet type, sequence flags 3, sequence count per APID and direction modulo 2¹⁴, number of bytes that follow
− 1.

Secondary header (14 bytes, big-endian): u8 packet type; u8 code; u16 first two bytes of the dictionary hash; u32
request id, 0 = unsolicited; u32 + u16 device time in seconds and milliseconds since the device's epoch, 0 from ground.

A signed packet to the device has APID 0x180 + type and an authentication trailer after its payload.

CRC-32 (``zlib.crc32``) over everything before it, last four bytes.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from enum import Enum, IntEnum

PRIMARY = struct.Struct(">HHH")
SECONDARY = struct.Struct(">BBHIIH")
CRC_BYTES = 4
OVERHEAD_BYTES = PRIMARY.size + SECONDARY.size + CRC_BYTES
APID_BASE, SIGNED_APID_BASE = 0x100, 0x180
TRAILER_BYTES = 25
"""Length of the authentication trailer of a signed packet."""
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


class Arrival(Enum):
    """Order of a received packet relative to earlier packets of its type: the latest, sent earlier but received late,
    or repeated."""

    CURRENT = "current"
    LATE = "late"
    REPEATED = "repeated"


@dataclass(frozen=True)
class Packet:
    """One packet, decoded down to its payload.

    ``to_device``: direction bit. ``prefix``: first two bytes of the sender's dictionary hash. ``arrival`` is set by the
    receiver. ``signed``: True if the packet has an authentication trailer, which is not part of the payload.
    """

    type: PacketType
    code: int
    request_id: int
    payload: bytes
    prefix: int
    to_device: bool
    sequence: int = 0
    time_s: float = 0.0
    arrival: Arrival = Arrival.CURRENT
    signed: bool = False


def labelled_bytes(data: bytes) -> list[tuple[str, bytes]]:
    """Return the header fields of an encoded packet as labelled bytes, in order, for the console. Payload and CRC are
    omitted."""
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

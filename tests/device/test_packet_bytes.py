"""Bytes of packets, compared with golden vectors and with an independent parser."""

from __future__ import annotations

import io
import math
import os
import zlib
from pathlib import Path

import pytest
from space_packet_parser import ccsds_generator

from gss.device.protocol.codec import encode
from gss.device.protocol.packet import Packet, PacketType
from gss.device.protocol.receiver import Damage, decode_packet
from gss.device.protocol.sender import encode_frame, encode_packet, with_crc
from gss.instruments.dictionary.definitions import Dictionary, Value
from gss.instruments.dictionary.read_dictionary import load_dictionary

GOLDEN = Path(__file__).parents[1] / "golden"
PREFIX = 0xABCD


def command(name: str, request_id: int, sequence: int, **arguments: Value) -> Packet:
    row = load_dictionary().command(name)
    payload = encode(row.arguments, arguments)
    return Packet(PacketType.COMMAND, row.code, request_id, payload, PREFIX, True, sequence)


def examples() -> dict[str, Packet]:
    """Return packets of every type, with a fixed dictionary prefix so that an edited dictionary does not change them."""
    d: Dictionary = load_dictionary()
    report = encode(
        d.service("REPORT").fields,
        {
            "stage": "rejected",
            "reason": "out_of_range",
            "progress": 0,
            "replayed": False,
            "detail": "slot: 0 – 3, got 9",
        },
    )
    status = encode(
        d.service("STATUS").fields,
        {"session": 7, "serial": 21, "stored_chunks": 18, "from_index": 0, "to_index": 512},
        {"ranges": [{"first": 0, "last": 9}, {"first": 12, "last": 19}]},
    )
    matches = encode(
        d.packet("matches").fields,
        {"frame_number": 41},
        {"items": [{"centroid": 0, "star": 6, "weight": 16.0}, {"centroid": 3, "star": 255, "weight": 15.0}]},
    )
    chunk = encode(d.service("CHUNK").fields, {"session": 7, "index": 3, "serial": 22, "data": bytes(range(16))})
    return {
        "hello": command("HELLO", 1, 0),
        "take-image": command("TAKE_IMAGE", 0x01020304, 5, slot=2, exposure_ms=250),
        "hint": command("SET_ATTITUDE_HINT", 9, 6, ra_deg=84.0, dec_deg=-5.5, roll_deg=12.25, uncertainty_deg=5.0),
        "report": Packet(PacketType.REPORT, 33, 0x01020304, report, PREFIX, False, 16383, 3661.25),
        "matches": Packet(PacketType.TELEMETRY, 4, 0, matches, PREFIX, False, 100, 7.5),
        "event": Packet(
            PacketType.EVENT, 1, 0, encode(d.service("EVENT").fields, {"text": "power_on, boot 1"}), PREFIX, False
        ),
        "status": Packet(PacketType.TRANSFER, 6, 12, status, PREFIX, False, 3, 99.999),
        "chunk": Packet(PacketType.TRANSFER, 4, 12, chunk, PREFIX, True, 8),
    }


@pytest.mark.parametrize("name", sorted(examples()))
def test_packet_has_its_golden_bytes_and_is_decoded_again(name: str) -> None:
    """Each packet has its golden bytes and is decoded to an equal packet. Other bytes would change the interface."""
    packet = examples()[name]
    data = encode_packet(packet)
    path = GOLDEN / f"link-{name}.hex"
    if os.environ.get("GSS_WRITE_GOLDEN"):
        path.write_text(encode_frame(data).hex(" ") + "\n")
    assert encode_frame(data) == bytes.fromhex(path.read_text())
    assert decode_packet(data) == packet


def test_another_ccsds_parser_reads_the_same_headers() -> None:
    """The package space_packet_parser reads the intended primary headers."""
    packets = [encode_packet(p) for p in examples().values()]
    parsed = list(ccsds_generator(io.BytesIO(b"".join(packets))))
    assert len(parsed) == len(packets)
    for ours, (data, theirs) in zip(examples().values(), zip(packets, parsed, strict=True), strict=True):
        assert bytes(theirs) == data
        assert theirs.apid == 0x100 + ours.type
        assert theirs.type == int(ours.to_device)
        assert theirs.sequence_count == ours.sequence
        assert theirs.sequence_flags == 3
        assert theirs.secondary_header_flag == 1
        assert theirs.version_number == 0


def test_header_fields_are_decoded_unchanged_at_their_limits() -> None:
    """Request id and device time are decoded unchanged at the ends of their ranges."""
    for request_id, time_s in ((0, 0.0), (0xFFFF_FFFF, 4294967295.0), (1, 0.999), (2, 59.9996)):
        packet = Packet(PacketType.TELEMETRY, 255, request_id, b"", 0xFFFF, False, 0, time_s)
        decoded = decode_packet(encode_packet(packet))
        assert isinstance(decoded, Packet)
        assert decoded.request_id == request_id
        assert math.isclose(decoded.time_s, time_s, abs_tol=0.0006)


def test_kinds_of_damage_are_distinguished() -> None:
    """A packet with a wrong length, a bad CRC and an unknown APID give different errors."""
    valid = encode_packet(examples()["hello"])
    assert decode_packet(valid[:10]) is Damage.TOO_SHORT
    assert decode_packet(valid[:-1] + bytes([valid[-1] ^ 1])) is Damage.BAD_CRC
    other_apid = bytearray(valid[:-4])
    other_apid[1] ^= 0x40
    assert decode_packet(with_crc(bytes(other_apid))) is Damage.UNKNOWN
    longer = valid[:-4] + b"extra"
    assert decode_packet(longer + zlib.crc32(longer).to_bytes(4, "big")) is Damage.TOO_SHORT

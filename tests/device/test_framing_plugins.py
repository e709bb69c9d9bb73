"""All framings with divided, damaged and endless input."""

from __future__ import annotations

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from gss.device.protocol.framing import FRAMINGS, MAX_PACKET_BYTES, framing_named
from gss.device.protocol.packet import PacketType
from gss.device.protocol.receiver import Deframer, LineReceiver
from gss.device.protocol.sender import LineSender, encode_frame
from gss.domain.errors import BadInput

FRAMING = st.sampled_from(sorted(FRAMINGS))
special = st.sampled_from([0x00, 0x01, 0xC0, 0xDB, 0xDC, 0xDD, 0xFF])
packets = st.lists(
    st.one_of(st.binary(min_size=1, max_size=300), st.lists(special, min_size=1, max_size=300).map(bytes)),
    min_size=1,
    max_size=8,
)


def pieces(data: bytes, cuts: list[int]) -> list[bytes]:
    edges = sorted(cut % (len(data) + 1) for cut in cuts)
    return [data[a:b] for a, b in zip([0, *edges], [*edges, len(data)], strict=True)]


@given(FRAMING, packets, st.lists(st.integers(0, 10_000), max_size=12))
def test_any_division_of_the_stream_gives_the_same_packets_in_both_framings(
    framing: str, sent: list[bytes], cuts: list[int]
) -> None:
    """The deframer returns the same packets for any division of the bytes into reads and any content."""
    deframer = Deframer(framing=framing)
    stream = b"".join(encode_frame(packet, framing) for packet in sent)
    assert [p for piece in pieces(stream, cuts) for p in deframer.feed(piece)] == sent
    assert (deframer.too_long, deframer.broken, deframer.unframed) == (0, 0, 0)


@given(FRAMING, st.integers(), st.sampled_from(["flip", "insert", "drop"]), st.integers(1, 6))
@settings(max_examples=200)
def test_damage_loses_only_touched_frames_in_both_framings(framing: str, seed: int, kind: str, hits: int) -> None:
    """A damaged, inserted or lost byte affects only its frame, and no false packet is accepted."""
    generator = random.Random(seed)
    sender = LineSender(to_device=False, prefix=0xC0DB, framing=framing)
    payloads = [i.to_bytes(2, "big") + generator.randbytes(generator.randrange(200)) for i in range(8)]
    frames = [sender.packet(PacketType.TELEMETRY, 1, 0, p) for p in payloads]
    targets = {generator.randrange(8) for _ in range(hits)}
    for index in targets:
        frame_bytes = bytearray(frames[index])
        position = generator.randrange(len(frame_bytes))
        if kind == "flip":
            frame_bytes[position] ^= 1 << generator.randrange(8)
        elif kind == "insert":
            frame_bytes.insert(position, generator.randrange(256))
        else:
            del frame_bytes[position]
        frames[index] = bytes(frame_bytes)
    receiver = LineReceiver(from_device=True, framing=framing)
    received = [p.payload for p in receiver.feed(FRAMINGS[framing].delimiter + b"".join(frames))]
    assert set(received) <= set(payloads)
    untouched = [p for i, p in enumerate(payloads) if i not in targets]
    assert [p for p in received if p in untouched] == untouched
    assert receiver.good == len(received)


@given(FRAMING, st.binary(max_size=9000), st.lists(st.integers(0, 10_000), max_size=12))
def test_noise_never_raises_and_memory_stays_bounded_in_both_framings(
    framing: str, noise: bytes, cuts: list[int]
) -> None:
    """For any input, at most one frame of maximum length is stored, every byte is counted, and the next packet is
    received."""
    receiver = LineReceiver(from_device=True, framing=framing)
    for piece in pieces(noise, cuts):
        receiver.feed(piece)
        assert receiver.deframer.held_bytes <= FRAMINGS[framing].limit(MAX_PACKET_BYTES)
    assert receiver.deframer.bytes == len(noise)
    valid_frame = LineSender(to_device=False, prefix=1, framing=framing).packet(PacketType.TELEMETRY, 1, 0, b"next")
    assert receiver.feed(FRAMINGS[framing].delimiter + valid_frame)[-1].payload == b"next"


@pytest.mark.parametrize("framing", sorted(FRAMINGS))
def test_packets_above_the_maximum_are_counted_once_and_dropped(framing: str) -> None:
    """A packet of the maximum length is received. A longer one is dropped and counted once, also an endless one."""
    deframer = Deframer(64, framing)
    longest = bytes([0xC0, 0xDB] * 32)
    assert deframer.feed(encode_frame(longest, framing)) == [longest]
    assert deframer.feed(encode_frame(longest + b"\1", framing)) == []
    assert deframer.too_long == 1
    assert deframer.feed(FRAMINGS[framing].delimiter + b"\x11" * 100_000) == []
    assert deframer.held_bytes <= FRAMINGS[framing].limit(64)
    assert deframer.feed(FRAMINGS[framing].delimiter + encode_frame(b"next", framing)) == [b"next"]
    assert deframer.too_long == 2


def test_slip_has_the_bytes_of_rfc_1055() -> None:
    """END is C0, or DB DC within a packet. ESC is DB, or DB DD within a packet. A frame with another byte after ESC is
    dropped and counted."""
    assert encode_frame(bytes([1, 0xC0, 2, 0xDB, 3]), "slip").hex() == "c001dbdc02dbdd03c0"
    deframer = Deframer(framing="slip")
    assert deframer.feed(bytes.fromhex("c001db02c0c0dbc0c007c0")) == [b"\7"]
    assert deframer.broken == 2


def test_an_unknown_framing_is_rejected_with_the_known_names() -> None:
    """An unknown framing is rejected with the list of known names."""
    with pytest.raises(BadInput, match="unknown framing") as error:
        framing_named("hdlc")
    assert error.value.expected == "cobs | slip | kiss"
    with pytest.raises(BadInput):
        LineSender(to_device=True, prefix=0, framing="")

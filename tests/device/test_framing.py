"""Framing under every kind of damage."""

from __future__ import annotations

import random

from hypothesis import given, settings
from hypothesis import strategies as st

from gss.device.protocol.framing import MAX_PACKET_BYTES, encoded_limit
from gss.device.protocol.packet import PacketType
from gss.device.protocol.receiver import Deframer, LineReceiver
from gss.device.protocol.sender import LineSender, encode_frame

packets = st.lists(st.binary(min_size=1, max_size=300), min_size=1, max_size=8)


def split(data: bytes, seed: int) -> list[bytes]:
    chooser = random.Random(seed)
    cuts = sorted(chooser.randrange(len(data) + 1) for _ in range(chooser.randrange(12)))
    return [data[a:b] for a, b in zip([0, *cuts], [*cuts, len(data)], strict=True)]


@given(packets, st.integers())
def test_any_split_of_the_stream_gives_the_same_packets(sent: list[bytes], seed: int) -> None:
    """The division of bytes into reads does not matter."""
    deframer = Deframer()
    stream = b"".join(map(encode_frame, sent))
    got = [p for piece in split(stream, seed) for p in deframer.feed(piece)]
    assert got == sent
    assert (deframer.too_long, deframer.broken, deframer.unframed) == (0, 0, 0)


def numbered(count: int, sizes: random.Random) -> tuple[list[bytes], list[bytes]]:
    """Return framed telemetry packets that begin with their number, and the payloads."""
    sender = LineSender(to_device=False, prefix=0x1234)
    payloads = [i.to_bytes(2, "big") + sizes.randbytes(sizes.randrange(200)) for i in range(count)]
    return [sender.packet(PacketType.TELEMETRY, 1, 0, p) for p in payloads], payloads


@given(st.integers(), st.sampled_from(["flip", "insert", "drop"]), st.integers(1, 6))
@settings(max_examples=200)
def test_damage_loses_only_the_frames_it_touches(seed: int, kind: str, hits: int) -> None:
    """A flipped, inserted or lost byte costs only the frame it is in, and no false packet is accepted."""
    chooser = random.Random(seed)
    frames, payloads = numbered(8, chooser)
    touched: set[int] = set()
    damaged = []
    targets = {chooser.randrange(8) for _ in range(hits)}
    for index, frame in enumerate(frames):
        body = bytearray(frame)
        if index in targets:
            touched.add(index)
            at = chooser.randrange(len(body))
            if kind == "flip":
                body[at] ^= 1 << chooser.randrange(8)
            elif kind == "insert":
                body.insert(at, chooser.randrange(256))
            else:
                del body[at]
        damaged.append(bytes(body))
    receiver = LineReceiver(from_device=True)
    got = [p.payload for p in receiver.feed(b"\0" + b"".join(damaged))]
    assert set(got) <= set(payloads)
    assert [p for i, p in enumerate(payloads) if i not in touched] == [
        p for p in got if payloads.index(p) not in touched
    ]


@given(st.binary(max_size=5000), st.integers())
def test_noise_never_raises_and_uses_bounded_memory(noise: bytes, seed: int) -> None:
    """For any input the parser continues with at most one longest frame in memory."""
    receiver = LineReceiver(from_device=True)
    for piece in split(noise, seed):
        receiver.feed(piece)
        assert receiver.deframer.held_bytes <= encoded_limit()
    assert receiver.deframer.bytes == len(noise)


def test_endless_frame_is_dropped_once_and_the_next_one_arrives() -> None:
    """A frame above the maximum is counted and dropped before it fills memory."""
    deframer = Deframer(64)
    assert deframer.feed(b"\0" + b"\x11" * 100_000) == []
    assert deframer.held_bytes <= encoded_limit(64)
    assert deframer.feed(b"\0" + encode_frame(b"next")) == [b"next"]
    assert deframer.too_long == 1


def test_longest_packet_passes_and_one_byte_more_does_not() -> None:
    """The agreed maximum is inclusive."""
    deframer = Deframer()
    longest = bytes(range(1, 256)) * 8 + bytes(8)
    assert len(longest) == MAX_PACKET_BYTES
    assert deframer.feed(encode_frame(longest)) == [longest]
    worst = b"\x01" * (encoded_limit() + 1)
    assert deframer.feed(b"\0" + worst + b"\0") == []
    assert deframer.too_long == 1


def test_bytes_before_the_first_delimiter_are_dropped_and_counted() -> None:
    """A line opened in the middle of a frame starts with the next one."""
    deframer = Deframer()
    assert deframer.feed(b"tail of something" + encode_frame(b"whole")) == [b"whole"]
    assert deframer.unframed == len(b"tail of something")
    deframer.restart()
    assert deframer.feed(b"again" + encode_frame(b"x")) == [b"x"]


def test_receiver_counts_gaps_duplicates_and_damage() -> None:
    """Each counter has one cause."""
    sender = LineSender(to_device=False, prefix=1)
    frames = [sender.packet(PacketType.TELEMETRY, 1, 0, bytes([i])) for i in range(6)]
    receiver = LineReceiver(from_device=True)
    bad = bytearray(frames[4])
    bad[-3] ^= 4
    receiver.feed(frames[0] + frames[1] + frames[1] + frames[3] + bytes(bad) + encode_frame(b"short"))
    other = LineSender(to_device=True, prefix=1).packet(PacketType.COMMAND, 1, 1, b"")
    receiver.feed(other)
    assert (receiver.good, receiver.sequence.duplicates, receiver.sequence.gaps) == (4, 1, 1)
    assert (receiver.bad_crc, receiver.too_short, receiver.unknown) == (1, 1, 1)

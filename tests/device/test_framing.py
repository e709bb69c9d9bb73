"""COBS framing with divided, damaged and endless input."""

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
    generator = random.Random(seed)
    cuts = sorted(generator.randrange(len(data) + 1) for _ in range(generator.randrange(12)))
    return [data[a:b] for a, b in zip([0, *cuts], [*cuts, len(data)], strict=True)]


@given(packets, st.integers())
def test_any_split_of_the_stream_gives_the_same_packets(sent: list[bytes], seed: int) -> None:
    """The deframer returns the same packets for any division of the bytes into reads."""
    deframer = Deframer()
    stream = b"".join(map(encode_frame, sent))
    received = [p for piece in split(stream, seed) for p in deframer.feed(piece)]
    assert received == sent
    assert (deframer.too_long, deframer.broken, deframer.unframed) == (0, 0, 0)


def numbered(count: int, generator: random.Random) -> tuple[list[bytes], list[bytes]]:
    """Return framed telemetry packets, and their payloads, which begin with their number."""
    sender = LineSender(to_device=False, prefix=0x1234)
    payloads = [i.to_bytes(2, "big") + generator.randbytes(generator.randrange(200)) for i in range(count)]
    return [sender.packet(PacketType.TELEMETRY, 1, 0, p) for p in payloads], payloads


@given(st.integers(), st.sampled_from(["flip", "insert", "drop"]), st.integers(1, 6))
@settings(max_examples=200)
def test_damage_loses_only_the_frames_it_touches(seed: int, kind: str, hits: int) -> None:
    """A damaged, inserted or lost byte affects only its frame, and no false packet is accepted."""
    generator = random.Random(seed)
    frames, payloads = numbered(8, generator)
    touched: set[int] = set()
    damaged = []
    targets = {generator.randrange(8) for _ in range(hits)}
    for index, frame in enumerate(frames):
        frame_bytes = bytearray(frame)
        if index in targets:
            touched.add(index)
            position = generator.randrange(len(frame_bytes))
            if kind == "flip":
                frame_bytes[position] ^= 1 << generator.randrange(8)
            elif kind == "insert":
                frame_bytes.insert(position, generator.randrange(256))
            else:
                del frame_bytes[position]
        damaged.append(bytes(frame_bytes))
    receiver = LineReceiver(from_device=True)
    received = [p.payload for p in receiver.feed(b"\0" + b"".join(damaged))]
    assert set(received) <= set(payloads)
    assert [p for i, p in enumerate(payloads) if i not in touched] == [
        p for p in received if payloads.index(p) not in touched
    ]


@given(st.binary(max_size=5000), st.integers())
def test_noise_never_raises_and_uses_bounded_memory(noise: bytes, seed: int) -> None:
    """For any input, the receiver raises no exception and stores at most one frame of maximum length."""
    receiver = LineReceiver(from_device=True)
    for piece in split(noise, seed):
        receiver.feed(piece)
        assert receiver.deframer.held_bytes <= encoded_limit()
    assert receiver.deframer.bytes == len(noise)


def test_endless_frame_is_dropped_once_and_the_next_one_arrives() -> None:
    """A frame above the maximum is dropped before it fills memory and counted once. The next frame is received."""
    deframer = Deframer(64)
    assert deframer.feed(b"\0" + b"\x11" * 100_000) == []
    assert deframer.held_bytes <= encoded_limit(64)
    assert deframer.feed(b"\0" + encode_frame(b"next")) == [b"next"]
    assert deframer.too_long == 1


def test_longest_packet_passes_and_one_byte_more_does_not() -> None:
    """A packet of the maximum length is received. A longer frame is dropped and counted."""
    deframer = Deframer()
    longest = bytes(range(1, 256)) * 8 + bytes(8)
    assert len(longest) == MAX_PACKET_BYTES
    assert deframer.feed(encode_frame(longest)) == [longest]
    worst = b"\x01" * (encoded_limit() + 1)
    assert deframer.feed(b"\0" + worst + b"\0") == []
    assert deframer.too_long == 1


def test_bytes_before_the_first_delimiter_are_dropped_and_counted() -> None:
    """Bytes before the first delimiter are dropped and counted, and the next frame is received."""
    deframer = Deframer()
    assert deframer.feed(b"tail of something" + encode_frame(b"whole")) == [b"whole"]
    assert deframer.unframed == len(b"tail of something")
    deframer.restart()
    assert deframer.feed(b"again" + encode_frame(b"x")) == [b"x"]


def test_receiver_counts_gaps_duplicates_and_damage() -> None:
    """Each kind of damage increases exactly one counter."""
    sender = LineSender(to_device=False, prefix=1)
    frames = [sender.packet(PacketType.TELEMETRY, 1, 0, bytes([i])) for i in range(6)]
    receiver = LineReceiver(from_device=True)
    damaged_frame = bytearray(frames[4])
    damaged_frame[-3] ^= 4
    receiver.feed(frames[0] + frames[1] + frames[1] + frames[3] + bytes(damaged_frame) + encode_frame(b"short"))
    other = LineSender(to_device=True, prefix=1).packet(PacketType.COMMAND, 1, 1, b"")
    receiver.feed(other)
    assert (receiver.good, receiver.sequence.duplicates, receiver.sequence.gaps) == (4, 1, 1)
    assert (receiver.bad_crc, receiver.too_short, receiver.unknown) == (1, 1, 1)

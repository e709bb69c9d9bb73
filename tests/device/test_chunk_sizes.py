"""Chunk size as a function of losses, and conversion of held ranges to another chunk size."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from gss.device.protocol.chunk_size import (
    FRAME_OVERHEAD_BYTES,
    best_chunk_bytes,
    carried_share,
    loss_per_byte,
    regrid,
    smaller_chunk_bytes,
)
from gss.device.protocol.receiver import LineReceiver
from gss.device.protocol.sender import LineSender
from gss.device.protocol.transfer import ChunkSender, ChunkSet, chunk_count
from gss.device.session_counters import LineQuality
from gss.device.session_events import Direction


@pytest.mark.parametrize(
    ("bit_error_rate", "best"), [(0.0, 1024), (1e-6, 1024), (1e-5, 1024), (1e-4, 256), (3e-4, 128), (1e-2, 128)]
)
def test_the_best_size_follows_the_bit_error_rate(bit_error_rate: float, best: int) -> None:
    """The best size has the highest throughput if a byte survives with probability (1 − p)⁸. Of equal sizes it is the
    largest."""
    assert best_chunk_bytes(-8 * math.log1p(-bit_error_rate)) == best


def test_losses_give_the_bit_error_rate() -> None:
    """The loss rate per byte is estimated from lost frames: at a bit error rate of 1e-4, 57.3 % of 1064-byte frames are
    lost."""
    rate = -8 * math.log1p(-1e-4)
    lost = round(1000 * (1 - math.exp(-rate * 1064)))
    assert loss_per_byte(lost, 1000, 1064) == pytest.approx(rate, rel=0.01)
    assert loss_per_byte(0, 1000, 1064) == loss_per_byte(3, 0, 10) == 0.0
    assert math.isfinite(loss_per_byte(1000, 1000, 1064))


@pytest.mark.parametrize(
    ("chunk_bytes", "lost", "sent", "smaller"),
    [
        (1024, 0, 500, None),
        (1024, 3, 3, None),  # too few to estimate
        (1024, 1, 100, None),  # a small loss does not justify more headers
        (1024, 57, 100, 256),
        (1024, 8, 8, 128),
        (256, 20, 100, None),
        (128, 90, 100, None),
    ],
)
def test_a_transfer_is_reopened_only_with_a_benefit(
    chunk_bytes: int, lost: int, sent: int, smaller: int | None
) -> None:
    """A smaller size is proposed only with enough samples and if it carries clearly more payload per byte sent."""
    assert smaller_chunk_bytes(chunk_bytes, lost, sent) == smaller
    if smaller is not None:
        rate = loss_per_byte(lost, sent, chunk_bytes + FRAME_OVERHEAD_BYTES)
        assert carried_share(smaller, rate) > carried_share(chunk_bytes, rate)


@given(st.integers(1, 5000), st.integers(1, 700), st.integers(1, 700), st.data())
def test_regridding_marks_exactly_the_chunks_with_every_byte_held(
    size: int, old: int, new: int, data: st.DataObject
) -> None:
    """After conversion, a chunk is marked exactly if all of its bytes are held."""
    count = chunk_count(size, old)
    held = ChunkSet(count, data.draw(st.lists(st.integers(0, count - 1), max_size=40)))
    byte_held = bytearray(size)
    for first, last in held.ranges()[0]:
        byte_held[first * old : (last + 1) * old] = b"\1" * (min((last + 1) * old, size) - first * old)
    expected = [i for i in range(chunk_count(size, new)) if all(byte_held[i * new : (i + 1) * new])]
    assert regrid(held.ranges()[0], size, old, new) == expected


def test_a_sender_requests_status_after_its_last_chunk() -> None:
    """After the last chunk the sender requests status, because no later chunk would cause a report. Without the request,
    a lost last chunk would cost a timeout."""
    sender = ChunkSender(3, 16, 5.0)
    assert [sender.next_chunk(0.0) for _ in range(3)] == [(0, 1), (1, 2), (2, 3)]
    assert sender.request_due(0.0) == (3, 0)
    assert sender.request_due(4.9) is None
    assert sender.request_due(5.1) == (3, 0)


def uplink_chunk(*samples: tuple[int, int, int]) -> int:
    """Return the chunk size of an upload after samples of (packets of 1064 B sent, good, damaged), one per second. The
    first one is before the first housekeeping."""
    quality, sender, receiver = LineQuality(), LineSender(to_device=True, prefix=0), LineReceiver(from_device=True)
    quality.note(0.0, sender, receiver, None)
    for now_s, (sent, good, bad) in enumerate(samples, 1):
        sender.good, sender.bytes = sent, 1064 * sent
        quality.note(float(now_s), sender, receiver, {"frames_good": good, "frames_bad": bad})
    return quality.chunk_bytes(Direction.UP)


def test_the_chunk_size_of_an_upload_follows_the_damage_of_sent_packets() -> None:
    """Noise that the device counts as packets while few or no packets are sent, and the damage before the connection, do
    not change the chunk size."""
    assert uplink_chunk((10, 10, 0), (110, 53, 57)) == 256
    assert uplink_chunk((10, 10, 0), (10, 10, 3)) == 1024
    assert uplink_chunk((10, 10, 0), (12, 12, 9)) == 1024
    assert uplink_chunk((4, 4000, 20), (6, 4002, 20)) == 1024


def test_the_uplink_is_sampled_only_with_new_housekeeping() -> None:
    """Packets sent since the last housekeeping are not compared with its counters."""
    quality, sender, receiver = LineQuality(), LineSender(to_device=True, prefix=0), LineReceiver(from_device=True)
    quality.note(0.0, sender, receiver, {"frames_good": 0, "frames_bad": 0})
    sender.good, sender.bytes = 10, 640
    damaged = {"frames_good": 5, "frames_bad": 5}
    quality.note(1.0, sender, receiver, damaged)
    chunk = quality.chunk_bytes(Direction.UP)
    sender.good, sender.bytes = 1000, 1_000_000
    quality.note(2.0, sender, receiver, damaged)
    assert quality.chunk_bytes(Direction.UP) == chunk < 1024

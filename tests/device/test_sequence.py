"""Sequence counts: gaps, late, repeated and replayed packets, and restarts of the sender."""

from __future__ import annotations

import numpy as np
import pytest

from gss.device.protocol.packet import SEQUENCE_MODULO, Arrival, Packet, PacketType
from gss.device.protocol.sequence_counts import SequenceTracker

CURRENT = Arrival.CURRENT


def packet(sequence: int, time_s: float, kind: PacketType = PacketType.TELEMETRY) -> Packet:
    """Return a packet from the device."""
    return Packet(kind, 1, 0, b"", 0, False, sequence % SEQUENCE_MODULO, time_s)


def test_a_late_packet_is_stale_and_no_longer_missing() -> None:
    """For packets 0, 1, 3, 2, 4 there is one gap until the late packet arrives, and then none."""
    tracker = SequenceTracker()
    assert [tracker.arrival(packet(n, n)) for n in (0, 1, 3)] == [CURRENT] * 3
    assert tracker.gaps == 1
    assert tracker.arrival(packet(2, 2)) is Arrival.LATE
    assert tracker.arrival(packet(4, 4)) is CURRENT
    assert (tracker.gaps, tracker.duplicates) == (0, 0)


def test_a_replayed_packet_is_stale_and_a_duplicate() -> None:
    """A packet sent 20 minutes earlier is counted as a duplicate and changes neither the expected count nor the gaps."""
    tracker = SequenceTracker()
    for n in range(1300):
        assert tracker.arrival(packet(n, n)) is CURRENT
    assert tracker.arrival(packet(100, 100)) is Arrival.REPEATED
    assert tracker.arrival(packet(1300, 1300)) is CURRENT
    assert (tracker.gaps, tracker.duplicates) == (0, 1)


@pytest.mark.parametrize("age", [9000, 12000, 16000])
def test_a_replay_older_than_half_the_range_is_stale_too(age: int) -> None:
    """The count of such a packet seems to be ahead. Its device time shows that it is old, so it is not current."""
    tracker = SequenceTracker()
    for n in range(20_000):
        tracker.arrival(packet(n, n / 10))
    assert tracker.arrival(packet(20_000 - age, (20_000 - age) / 10)) is not CURRENT
    assert tracker.arrival(packet(20_000, 2000)) is CURRENT
    assert tracker.gaps == 0


def test_a_sender_that_restarts_its_count_is_current() -> None:
    """A packet whose count restarts at 0 is current if its device time continues."""
    tracker = SequenceTracker()
    for n in range(500):
        tracker.arrival(packet(n, n))
    assert tracker.arrival(packet(0, 501)) is CURRENT
    assert tracker.arrival(packet(1, 502)) is CURRENT
    assert (tracker.gaps, tracker.duplicates) == (0, 0)


@pytest.mark.parametrize("age", [1, 1200, 8300, 9000, 16_000, SEQUENCE_MODULO])
@pytest.mark.parametrize("reopened", [False, True])
def test_consecutive_old_packets_are_never_current(age: int, reopened: bool) -> None:
    """Five replayed packets in their order are not current and change no gaps, also directly after the line is reopened."""
    tracker = SequenceTracker()
    for n in range(20_000):
        tracker.arrival(packet(n, n))
    if reopened:
        tracker.reopen()
    replayed = range(20_000 - age - 5, 20_000 - age)
    assert CURRENT not in [tracker.arrival(packet(n, n)) for n in replayed]
    assert tracker.arrival(packet(20_000, 20_000)) is CURRENT
    assert (tracker.gaps, tracker.duplicates) == (0, 5)


def test_a_reset_clock_is_accepted_after_the_response_to_hello() -> None:
    """Packets with an earlier device time are old until the reply to HELLO confirms the reset clock. A reply that is only
    slightly late changes nothing."""
    tracker = SequenceTracker()
    tracker.arrival(packet(10, 1000))
    assert tracker.arrival(packet(11, 5)) is not CURRENT
    tracker.hello(999)
    assert tracker.arrival(packet(12, 6)) is not CURRENT
    tracker.hello(7)
    assert tracker.arrival(packet(13, 7)) is CURRENT
    assert tracker.arrival(packet(14, 8)) is CURRENT


def test_a_reopened_line_does_not_count_the_pause_as_a_gap() -> None:
    """Packets sent while the line was closed are not counted as missing."""
    tracker = SequenceTracker()
    tracker.arrival(packet(10, 1000))
    tracker.reopen()
    assert tracker.arrival(packet(900, 1890)) is CURRENT
    assert tracker.arrival(packet(902, 1892)) is CURRENT
    assert tracker.gaps == 1


def test_wrap_around_is_not_counted_as_a_gap() -> None:
    """A count of 0 after 16 383 is not counted as a gap."""
    tracker = SequenceTracker()
    for n in range(SEQUENCE_MODULO - 3, SEQUENCE_MODULO + 3):
        assert tracker.arrival(packet(n, n)) is CURRENT
    assert (tracker.gaps, tracker.duplicates) == (0, 0)


def test_counts_are_exact_under_loss_reordering_repetition_and_replay() -> None:
    """Over 50 000 packets, ``gaps`` is the number of lost packets and ``duplicates`` that of repeated ones (seed 7)."""
    rng = np.random.default_rng(7)
    tracker, lost, repeated, n = SequenceTracker(), 0, 0, 0
    tracker.arrival(packet(0, 0))
    while n < 50_000:
        n += 1
        draw = rng.random()
        if draw < 0.05:
            lost += 1
            continue
        if draw < 0.10:  # two packets are swapped
            assert tracker.arrival(packet(n + 1, n + 1)) is CURRENT
            assert tracker.arrival(packet(n, n)) is not CURRENT
            n += 1
            continue
        assert tracker.arrival(packet(n, n)) is CURRENT
        if draw < 0.15:
            repeated += 1
            repeated_number = n - int(rng.integers(0, 20))
            before = tracker.gaps
            assert tracker.arrival(packet(repeated_number, repeated_number)) is not CURRENT
            if tracker.gaps < before:  # the original was lost, so its repetition fills the gap
                lost, repeated = lost - 1, repeated - 1
    tracker.arrival(packet(n + 1, n + 1))
    assert (tracker.gaps, tracker.duplicates) == (lost, repeated)


def test_types_are_followed_separately() -> None:
    """Reports and telemetry have separate sequence counts."""
    tracker = SequenceTracker()
    assert tracker.arrival(packet(500, 1)) is CURRENT
    assert tracker.arrival(packet(3, 1, PacketType.REPORT)) is CURRENT
    assert tracker.gaps == 0

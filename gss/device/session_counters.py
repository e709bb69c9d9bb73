"""Counters of the bytes, packets and damaged packets on the line, and damage rates over the last minute."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

from gss.device.protocol.chunk_size import best_chunk_bytes, loss_per_byte
from gss.device.protocol.receiver import LineReceiver
from gss.device.protocol.sender import LineSender
from gss.device.session_events import Direction, DirectionCounters, LinkCounters
from gss.instruments.dictionary.definitions import Value

LATELY_S = 60.0
MIN_LOSSES = 3


def count_line(
    sender: LineSender, receiver: LineReceiver, undecodable: int, last_good_s: float | None, repeated_ids: int = 0
) -> LinkCounters:
    """Return the counters of both directions. ``undecodable``: number of intact packets that could not be decoded."""
    deframer = receiver.deframer
    received = DirectionCounters(
        bytes=deframer.bytes,
        good=receiver.good,
        bad_crc=receiver.bad_crc + deframer.broken,
        too_long=deframer.too_long,
        too_short=receiver.too_short,
        unframed=deframer.unframed,
        unknown=receiver.unknown,
        gaps=receiver.sequence.gaps,
        duplicates=receiver.sequence.duplicates,
        undecodable=undecodable,
        repeated_ids=repeated_ids,
    )
    return LinkCounters(DirectionCounters(sender.bytes, sender.good), received, last_good_s)


@dataclass(frozen=True)
class _Sample:
    """Counters of bytes, packets and damaged packets of one direction at one time."""

    bytes: int
    packets: int
    damaged: int

    def rate_since(self, before: _Sample) -> float:
        """Return the damage rate per byte since the sample ``before``; 0 if too few packets were damaged for an
        estimate."""
        packets, damaged = self.packets - before.packets, self.damaged - before.damaged
        if damaged < MIN_LOSSES or packets < damaged:
            return 0.0
        return loss_per_byte(damaged, packets, (self.bytes - before.bytes) / packets)


class LineQuality:
    """Damage rate per byte of each direction over the last minute.

    The host counts the packets that it receives. For the other direction, the device counts the packets that it receives
    and reports the counts in housekeeping.
    """

    def __init__(self) -> None:
        self._samples: deque[tuple[float, _Sample, _Sample]] = deque()

    def note(
        self, now_s: float, sender: LineSender, receiver: LineReceiver, housekeeping: Mapping[str, Value] | None
    ) -> None:
        """Sample the counters. Call about once per second."""
        down = _Sample(receiver.deframer.bytes, receiver.good + receiver.bad_total, receiver.bad_total)
        sensed = housekeeping or {}
        bad = int(sensed.get("frames_bad", 0))
        up = _Sample(sender.bytes, int(sensed.get("frames_good", 0)) + bad, bad)
        newest = self._samples[-1] if self._samples else None
        if newest is not None and up.packets < newest[2].packets:
            self._samples.clear()  # the device has restarted and reset its counters
        self._samples.append((now_s, down, up))
        while now_s - self._samples[0][0] > LATELY_S:
            self._samples.popleft()

    def chunk_bytes(self, direction: Direction) -> int:
        """Return the chunk size with the highest throughput at the current damage rate."""
        if not self._samples:
            return best_chunk_bytes(0.0)
        (_, down_before, up_before), (_, down, up) = self._samples[0], self._samples[-1]
        is_down = direction is Direction.DOWN
        return best_chunk_bytes(down.rate_since(down_before) if is_down else up.rate_since(up_before))

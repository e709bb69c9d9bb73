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
    """Counters of one direction at one time: bytes and packets sent, and packets received, of which some are damaged."""

    bytes: int
    sent: int
    packets: int
    damaged: int

    def rate_since(self, before: _Sample) -> float:
        """Return the damage rate per byte since the sample ``before``; 0 if too few packets were damaged for an
        estimate. Received packets in excess of the packets sent are noise."""
        sent, packets = self.sent - before.sent, self.packets - before.packets
        noise = max(packets - sent, 0)
        damaged = self.damaged - before.damaged - noise
        if damaged < MIN_LOSSES or packets - noise < damaged:
            return 0.0
        return loss_per_byte(damaged, packets - noise, (self.bytes - before.bytes) / sent)


class LineQuality:
    """Damage rate per byte of each direction over the last minute.

    The host counts the packets that it receives. For the other direction, the device counts the packets that it receives
    and reports the counts in housekeeping.
    """

    def __init__(self) -> None:
        self._samples: dict[Direction, deque[tuple[float, _Sample]]] = {d: deque() for d in Direction}
        self._housekeeping: Mapping[str, Value] | None = None

    def note(
        self, now_s: float, sender: LineSender, receiver: LineReceiver, housekeeping: Mapping[str, Value] | None
    ) -> None:
        """Sample the counters. Call about once per second. The uplink is sampled only at each new housekeeping packet,
        because older counters do not include the packets sent since."""
        received = receiver.good + receiver.bad_total
        self._add(now_s, Direction.DOWN, _Sample(receiver.deframer.bytes, received, received, receiver.bad_total))
        if housekeeping is not None and housekeeping is not self._housekeeping:
            good, bad = int(housekeeping.get("frames_good", 0)), int(housekeeping.get("frames_bad", 0))
            self._add(now_s, Direction.UP, _Sample(sender.bytes, sender.good, good + bad, bad))
        self._housekeeping = housekeeping
        for samples in self._samples.values():
            while samples and now_s - samples[0][0] > LATELY_S:
                samples.popleft()

    def _add(self, now_s: float, direction: Direction, sample: _Sample) -> None:
        samples = self._samples[direction]
        if samples and sample.packets < samples[-1][1].packets:
            samples.clear()  # the device has restarted and reset its counters
        samples.append((now_s, sample))

    def chunk_bytes(self, direction: Direction) -> int:
        """Return the chunk size with the highest throughput at the current damage rate."""
        samples = self._samples[direction]
        return best_chunk_bytes(samples[-1][1].rate_since(samples[0][1]) if samples else 0.0)

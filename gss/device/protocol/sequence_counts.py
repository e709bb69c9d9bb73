"""Follow the sequence counts of received packets to detect missing, repeated and late packets, and restarts of the
sender."""

from __future__ import annotations

from gss.device.protocol.packet import SEQUENCE_MODULO, Arrival, Packet, PacketType

HALF = SEQUENCE_MODULO // 2
MAX_MISSING = 4096
"""Maximum number of missing counts stored per packet type. They identify packets that arrive late."""
CLOCK_BACK_S = 5.0
"""If a response to HELLO is older than the latest packet by more than this time, the device's clock was reset."""


class _Stream:
    """Packets of one type. ``expected``: next sequence count; None: any. ``newest_s``: device time of the latest packet."""

    def __init__(self, newest_s: float) -> None:
        self.expected: int | None = None
        self.newest_s = newest_s
        self.missing: dict[int, None] = {}


class SequenceTracker:
    """Classifies packets by device time and sequence count. A count up to half the range ahead of the expected one is a gap, any
    other is a step back.

    The device's clock never goes back, so a packet with an earlier device time than the latest of its type was sent earlier: it
    is late if its count was missing, otherwise repeated. A step back with a later device time means that the sender has restarted
    its count. ``gaps``: packets still missing; ``duplicates``: repeated packets.
    """

    def __init__(self) -> None:
        self.gaps = self.duplicates = 0
        self._streams: dict[PacketType, _Stream] = {}

    def restart(self) -> None:
        """Accept any next packet of each type, because the sender is another device or its clock was reset."""
        self._streams.clear()

    def hello(self, device_time_s: float) -> None:
        """Restart if the response to a HELLO shows that the device's clock was reset."""
        if any(device_time_s < stream.newest_s - CLOCK_BACK_S for stream in self._streams.values()):
            self.restart()

    def reopen(self) -> None:
        """Accept any next count of each type, but no earlier device time. Called for the same sender on a newly opened
        line."""
        for stream in self._streams.values():
            stream.expected = None
            stream.missing.clear()

    def arrival(self, packet: Packet) -> Arrival:
        """Count a packet and return its order relative to earlier packets of its type."""
        stream = self._streams.setdefault(packet.type, _Stream(packet.time_s))
        ahead = 0 if stream.expected is None else (packet.sequence - stream.expected) % SEQUENCE_MODULO
        if packet.time_s < stream.newest_s or (ahead >= HALF and packet.time_s == stream.newest_s):
            if ahead >= HALF and packet.sequence in stream.missing:
                del stream.missing[packet.sequence]
                self.gaps -= 1
                return Arrival.LATE
            self.duplicates += 1
            return Arrival.REPEATED
        if ahead >= HALF:
            stream.missing.clear()  # numbers of the sender's previous run
        elif ahead:
            self.gaps += ahead
            first = packet.sequence - ahead  # counts wrap below 0
            stream.missing.update(
                dict.fromkeys(n % SEQUENCE_MODULO for n in range(first, packet.sequence)[-MAX_MISSING:])
            )
            while len(stream.missing) > MAX_MISSING:
                del stream.missing[next(iter(stream.missing))]
        stream.missing.pop(packet.sequence, None)  # the count has wrapped since that number was missed
        stream.expected = (packet.sequence + 1) % SEQUENCE_MODULO
        stream.newest_s = packet.time_s
        return Arrival.CURRENT

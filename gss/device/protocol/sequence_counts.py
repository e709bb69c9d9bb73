"""Follow the sequence counts of received packets: missing, repeated and late ones, and restarts of the sender."""

from __future__ import annotations

from gss.device.protocol.packet import SEQUENCE_MODULO, Arrival, Packet, PacketType

HALF = SEQUENCE_MODULO // 2
MAX_MISSING = 4096
"""Missing numbers remembered per packet type, to recognise packets that arrive late."""


class _Stream:
    """Packets of one type. ``newest_s``: device time of the newest packet. ``doubtful``: a count ahead with an earlier device
    time, which is taken for a replay unless the next packet follows it."""

    def __init__(self, first: Packet) -> None:
        self.expected = (first.sequence + 1) % SEQUENCE_MODULO
        self.newest_s = first.time_s
        self.missing: dict[int, None] = {}
        self.doubtful: int | None = None


class SequenceTracker:
    """Classifies packets by their sequence count, with the half-range rule: a count up to half the range ahead of the
    expected one is a gap, any other is a step back.

    A step back is a packet sent earlier (late or repeated), unless its device time is later than that of the newest
    packet: then the sender has restarted its count. A gap with an earlier device time is a packet of long ago, unless the
    next packet follows it: then the sender's clock was set back. ``gaps``: packets still missing; ``duplicates``: repeated
    packets.
    """

    def __init__(self) -> None:
        self.gaps = self.duplicates = 0
        self._streams: dict[PacketType, _Stream] = {}

    def restart(self) -> None:
        """Accept any count from the next packet of each type on: a new line, or a restarted sender."""
        self._streams.clear()

    def arrival(self, packet: Packet) -> Arrival:
        """Count a packet and return its place among those of its type."""
        stream = self._streams.get(packet.type)
        if stream is None:
            self._streams[packet.type] = _Stream(packet)
            return Arrival.CURRENT
        ahead = (packet.sequence - stream.expected) % SEQUENCE_MODULO
        if 0 < ahead < HALF and packet.time_s < stream.newest_s and packet.sequence != stream.doubtful:
            stream.doubtful = (packet.sequence + 1) % SEQUENCE_MODULO
            self.duplicates += 1
            return Arrival.REPEATED
        stream.doubtful = None
        if ahead >= HALF and packet.time_s <= stream.newest_s:
            if packet.sequence in stream.missing:
                del stream.missing[packet.sequence]
                self.gaps -= 1
                return Arrival.LATE
            self.duplicates += 1
            return Arrival.REPEATED
        if ahead >= HALF:
            stream.missing.clear()  # numbers of the sender's previous run
        elif ahead:
            self.gaps += ahead
            numbers = range(stream.expected, stream.expected + ahead)[-MAX_MISSING:]
            stream.missing.update(dict.fromkeys(n % SEQUENCE_MODULO for n in numbers))
            while len(stream.missing) > MAX_MISSING:
                del stream.missing[next(iter(stream.missing))]
        stream.missing.pop(packet.sequence, None)  # the count has wrapped since that number was missed
        stream.expected = (packet.sequence + 1) % SEQUENCE_MODULO
        stream.newest_s = packet.time_s
        return Arrival.CURRENT

"""What went over the line and how much of it was damaged."""

from __future__ import annotations

from collections.abc import Mapping

from gss.device.dictionary import Value
from gss.device.protocol.line import LineReceiver, LineSender
from gss.device.session_events import DirectionCounters, LinkCounters

NOISY_SHARE = 0.05
NOISY_AFTER = 20


def count_line(sender: LineSender, receiver: LineReceiver, undecodable: int, last_good_s: float | None) -> LinkCounters:
    """Counters of both directions; ``undecodable``: good packets that nobody could read."""
    deframer = receiver.deframer
    received = DirectionCounters(
        bytes=deframer.bytes,
        good=receiver.good,
        bad_crc=receiver.bad_crc + deframer.broken,
        too_long=deframer.too_long,
        too_short=receiver.too_short,
        unframed=deframer.unframed,
        unknown=receiver.unknown + undecodable,
        gaps=receiver.gaps,
        duplicates=receiver.duplicates,
    )
    return LinkCounters(DirectionCounters(sender.bytes, sender.good), received, last_good_s)


def is_noisy(receiver: LineReceiver, housekeeping: Mapping[str, Value] | None) -> bool:
    """Do many packets get damaged in either direction? Then small chunks lose less."""
    sensed = housekeeping or {}
    pairs = [
        (receiver.bad_total, receiver.good),
        (int(sensed.get("frames_bad", 0)), int(sensed.get("frames_good", 0))),
    ]
    return any(bad + good >= NOISY_AFTER and bad > NOISY_SHARE * (bad + good) for bad, good in pairs)

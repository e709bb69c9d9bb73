"""How large chunks should be on a line that loses some: from what was lost to the size that carries most."""

from __future__ import annotations

import math
from collections.abc import Iterable

LADDER_BYTES = (1024, 512, 256, 128)
FRAME_OVERHEAD_BYTES = 40
"""Header, CRC, chunk fields and framing round the content of a chunk."""

SURE_AFTER_CHUNKS = 16
SURE_AFTER_LOSSES = 8
WORTH_IT = 1.08
AS_GOOD = 0.95


def loss_per_byte(lost: int, sent: int, frame_bytes: float) -> float:
    """Rate of damage per byte that makes ``lost`` of ``sent`` frames of that length arrive damaged.

    Damage strikes bytes independently: a frame of n bytes survives with exp(−rate·n). All lost counts as all but half a one.
    """
    if sent <= 0 or lost <= 0:
        return 0.0
    share = min(lost, sent - 0.5) / sent
    return -math.log1p(-share) / frame_bytes


def carried_share(chunk_bytes: int, rate_per_byte: float) -> float:
    """Share of the line's bytes that become stored content when lost chunks are sent again."""
    frame = chunk_bytes + FRAME_OVERHEAD_BYTES
    return chunk_bytes / frame * math.exp(-rate_per_byte * frame)


def best_chunk_bytes(rate_per_byte: float, largest: int = LADDER_BYTES[0]) -> int:
    """The largest size of the ladder, up to ``largest``, that carries as much as any: estimates scatter, and large is cheap."""
    allowed = [size for size in LADDER_BYTES if size <= largest] or [LADDER_BYTES[-1]]
    most = max(carried_share(size, rate_per_byte) for size in allowed)
    return next(size for size in allowed if carried_share(size, rate_per_byte) >= AS_GOOD * most)


def smaller_chunk_bytes(chunk_bytes: int, lost: int, sent: int) -> int | None:
    """A smaller size that is worth re-opening a transfer for after this experience with it; None to go on as it is."""
    if sent < SURE_AFTER_CHUNKS and lost < SURE_AFTER_LOSSES:
        return None
    rate = loss_per_byte(lost, sent, chunk_bytes + FRAME_OVERHEAD_BYTES)
    best = best_chunk_bytes(rate, chunk_bytes)
    gained = carried_share(best, rate) > WORTH_IT * carried_share(chunk_bytes, rate)
    return best if best < chunk_bytes and gained else None


def regrid(ranges: Iterable[tuple[int, int]], size: int, old_bytes: int, new_bytes: int) -> list[int]:
    """Numbers of the chunks of ``new_bytes`` that lie wholly inside held ranges of chunks of ``old_bytes``.

    ``ranges``: first and last inclusive, ascending and apart. The last chunk of ``size`` bytes may be short in both grids.
    """
    numbers: list[int] = []
    for first, last in ranges:
        start, end = first * old_bytes, min((last + 1) * old_bytes, size)
        past = -(-size // new_bytes) if end == size else end // new_bytes
        numbers += range(-(-start // new_bytes), past)
    return numbers

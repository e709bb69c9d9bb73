"""Chunk size for a lossy line: estimates the loss rate and selects the size with the highest throughput."""

from __future__ import annotations

import math
from collections.abc import Iterable

LADDER_BYTES = (1024, 512, 256, 128)
FRAME_OVERHEAD_BYTES = 40
"""Bytes of header, CRC, chunk fields and framing that each chunk adds to its data."""

SURE_AFTER_CHUNKS = 16
SURE_AFTER_LOSSES = 8
WORTH_IT = 1.08
AS_GOOD = 0.95


def loss_per_byte(lost: int, sent: int, frame_bytes: float) -> float:
    """Return the damage rate per byte at which ``lost`` of ``sent`` frames of ``frame_bytes`` arrive damaged.

    Bytes are damaged independently: a frame of n bytes survives with probability exp(−rate·n). If all frames were lost,
    half a frame is counted as received to keep the rate finite.
    """
    if sent <= 0 or lost <= 0:
        return 0.0
    share = min(lost, sent - 0.5) / sent
    return -math.log1p(-share) / frame_bytes


def carried_share(chunk_bytes: int, rate_per_byte: float) -> float:
    """Return the stored data as a fraction of the transmitted bytes if lost chunks are sent again."""
    frame = chunk_bytes + FRAME_OVERHEAD_BYTES
    return chunk_bytes / frame * math.exp(-rate_per_byte * frame)


def best_chunk_bytes(rate_per_byte: float, largest: int = LADDER_BYTES[0]) -> int:
    """Return the largest size of the ladder, up to ``largest``, whose throughput is within 5 % of the best throughput.
    The best size itself is not used, because the loss estimates scatter and larger chunks cost little.
    """
    allowed = [size for size in LADDER_BYTES if size <= largest] or [LADDER_BYTES[-1]]
    best_share = max(carried_share(size, rate_per_byte) for size in allowed)
    return next(size for size in allowed if carried_share(size, rate_per_byte) >= AS_GOOD * best_share)


def smaller_chunk_bytes(chunk_bytes: int, lost: int, sent: int) -> int | None:
    """Return a smaller chunk size if the observed loss justifies reopening the transfer with it, otherwise None.

    ``lost`` of ``sent`` chunks of ``chunk_bytes`` were lost.
    """
    if sent < SURE_AFTER_CHUNKS and lost < SURE_AFTER_LOSSES:
        return None
    rate = loss_per_byte(lost, sent, chunk_bytes + FRAME_OVERHEAD_BYTES)
    best = best_chunk_bytes(rate, chunk_bytes)
    gained = carried_share(best, rate) > WORTH_IT * carried_share(chunk_bytes, rate)
    return best if best < chunk_bytes and gained else None


def regrid(ranges: Iterable[tuple[int, int]], size: int, old_bytes: int, new_bytes: int) -> list[int]:
    """Return the chunk numbers in the new grid (``new_bytes`` per chunk) that stored ranges of the old grid
    (``old_bytes``) cover completely.

    ``ranges``: first and last inclusive, ascending and disjoint. The last chunk of ``size`` bytes may be short in both
    grids.
    """
    numbers: list[int] = []
    for first, last in ranges:
        start, end = first * old_bytes, min((last + 1) * old_bytes, size)
        past = -(-size // new_bytes) if end == size else end // new_bytes
        numbers += range(-(-start // new_bytes), past)
    return numbers

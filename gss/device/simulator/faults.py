"""Faults of the line, by seed: flipped bits, lost runs of bytes, stalls. One instance per direction."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class FaultRates:
    """``bit_error_rate`` per bit; ``drop_rate`` and ``duplicate_rate`` per piece of up to 64 bytes; ``stall_rate``
    per second, each of ``stall_s``."""

    bit_error_rate: float = 0.0
    drop_rate: float = 0.0
    duplicate_rate: float = 0.0
    stall_rate: float = 0.0
    stall_s: float = 0.5


PIECE_BYTES = 64


class LineFaults:
    """Spoils bytes on their way."""

    def __init__(self, rates: FaultRates, seed: int) -> None:
        self._rates = rates
        self._rng = np.random.default_rng(seed)
        self._stalled_until_s = -1.0
        self._looked_s = 0.0

    def apply(self, data: bytes) -> bytes:
        """The bytes as they arrive."""
        r = self._rates
        if not data or not (r.bit_error_rate or r.drop_rate or r.duplicate_rate):
            return data
        pieces = [data[i : i + PIECE_BYTES] for i in range(0, len(data), PIECE_BYTES)]
        kept: list[bytes] = []
        for piece in pieces:
            luck = self._rng.random()
            if luck < r.drop_rate:
                continue
            kept.append(piece * 2 if luck > 1 - r.duplicate_rate else piece)
        return self._flip(b"".join(kept))

    def _flip(self, data: bytes) -> bytes:
        count = int(self._rng.binomial(8 * len(data), self._rates.bit_error_rate)) if data else 0
        if not count:
            return data
        spoiled = bytearray(data)
        for bit in self._rng.integers(0, 8 * len(data), count):
            spoiled[int(bit) // 8] ^= 1 << (int(bit) % 8)
        return bytes(spoiled)

    def stalled(self, now_s: float) -> bool:
        """Does the line stand still now?"""
        if now_s < self._stalled_until_s:
            return True
        elapsed_s, self._looked_s = max(0.0, now_s - self._looked_s), now_s
        if self._rates.stall_rate and self._rng.random() < 1 - np.exp(-self._rates.stall_rate * elapsed_s):
            self._stalled_until_s = now_s + self._rates.stall_s
            return True
        return False

"""Seeded and counted line faults: flipped bits, bursts, lost and duplicated pieces, delay, stalls, disconnection.

Each direction has a LineFaults. A LineControl manages both; an exercise uses it to change faults while the line is
open.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, fields, replace

import numpy as np

from gss.domain.errors import BadInput

PIECE_BYTES = 64
BURST_BYTES = 16
LAST_WORDS_S = 0.2
MAX_DISCONNECT_S = 3600.0
LIMITS = {
    "bit_error_rate": 0.5,
    "drop_rate": 1.0,
    "duplicate_rate": 1.0,
    "burst_rate": 1.0,
    "stall_rate": 100.0,
    "stall_s": 60.0,
    "delay_s": 60.0,
}


@dataclass(frozen=True)
class FaultRates:
    """Rates of the faults of one direction.

    ``bit_error_rate``: per bit; ``drop_rate``, ``duplicate_rate`` and ``burst_rate``: per piece of up to 64 bytes (a
    burst replaces up to 16 bytes by noise); ``stall_rate``: stalls per second, each ``stall_s`` long; ``delay_s``:
    delay of every byte.
    """

    bit_error_rate: float = 0.0
    drop_rate: float = 0.0
    duplicate_rate: float = 0.0
    stall_rate: float = 0.0
    stall_s: float = 0.5
    burst_rate: float = 0.0
    delay_s: float = 0.0

    def __post_init__(self) -> None:
        for name, maximum in LIMITS.items():
            value = getattr(self, name)
            if not 0 <= value <= maximum:
                raise BadInput(f"{name} is out of range", expected=f"0 – {maximum:g}", got=f"{value:g}")

    @property
    def spoil(self) -> bool:
        """True if bytes can be lost, duplicated or changed."""
        return bool(self.bit_error_rate or self.drop_rate or self.duplicate_rate or self.burst_rate)


@dataclass
class FaultCounts:
    """Counters of the faults applied to one direction."""

    bits_flipped: int = 0
    bursts: int = 0
    pieces_dropped: int = 0
    pieces_doubled: int = 0
    stalls: int = 0
    bytes_delayed: int = 0
    bytes_lost_disconnected: int = 0
    bytes_lost_unread: int = 0


class LineFaults:
    """Applies faults to the bytes of one direction."""

    def __init__(self, rates: FaultRates, seed: int) -> None:
        self.rates = rates
        self.counts = FaultCounts()
        self._rng = np.random.default_rng(seed)
        self._stalled_until_s = -1.0
        self._looked_s = 0.0
        self._late: deque[tuple[float, bytes]] = deque()

    def apply(self, data: bytes) -> bytes:
        """Return the data with all faults except delay."""
        if not data or not self.rates.spoil:
            return data
        rates, delivered = self.rates, []
        for start in range(0, len(data), PIECE_BYTES):
            piece, luck = data[start : start + PIECE_BYTES], self._rng.random()
            if luck < rates.drop_rate:
                self.counts.pieces_dropped += 1
                continue
            if rates.burst_rate and self._rng.random() < rates.burst_rate:
                piece = self._burst(piece)
            if luck > 1 - rates.duplicate_rate:
                self.counts.pieces_doubled += 1
                piece = piece * 2
            delivered.append(piece)
        return self._flip(b"".join(delivered))

    def _burst(self, piece: bytes) -> bytes:
        """Replace a part of the piece by noise."""
        self.counts.bursts += 1
        length = int(self._rng.integers(1, min(BURST_BYTES, len(piece)) + 1))
        start = int(self._rng.integers(0, len(piece) - length + 1))
        return piece[:start] + self._rng.bytes(length) + piece[start + length :]

    def _flip(self, data: bytes) -> bytes:
        count = int(self._rng.binomial(8 * len(data), self.rates.bit_error_rate)) if data else 0
        if not count:
            return data
        self.counts.bits_flipped += count
        spoiled = bytearray(data)
        for bit in self._rng.integers(0, 8 * len(data), count):
            spoiled[int(bit) // 8] ^= 1 << (int(bit) % 8)
        return bytes(spoiled)

    def carry(self, data: bytes, now_s: float) -> bytes:
        """Apply all faults to ``data``. Returns the bytes that are due at the other end, in order."""
        return self.late(self.apply(data), now_s)

    def late(self, data: bytes, now_s: float) -> bytes:
        """Delay ``data``. Returns the bytes that are due."""
        if not self._late and not self.rates.delay_s:
            return data
        if data:
            self.counts.bytes_delayed += len(data)
            self._late.append((now_s + self.rates.delay_s, data))
        due = []
        while self._late and self._late[0][0] <= now_s:
            due.append(self._late.popleft()[1])
        return b"".join(due)

    def lose_all(self) -> None:
        """Discard delayed bytes when the line is disconnected."""
        self.counts.bytes_lost_disconnected += sum(len(data) for _, data in self._late)
        self._late.clear()

    def stalled(self, now_s: float) -> bool:
        """True if the line is stalled now."""
        if now_s < self._stalled_until_s:
            return True
        elapsed_s, self._looked_s = max(0.0, now_s - self._looked_s), now_s
        if self.rates.stall_rate and self._rng.random() < 1 - np.exp(-self.rates.stall_rate * elapsed_s):
            self._stalled_until_s = now_s + self.rates.stall_s
            self.counts.stalls += 1
            return True
        return False


class LineControl:
    """Faults of both directions, which can change at any time. ``up``: to the device; ``down``: from the device."""

    def __init__(self, rates: FaultRates | None = None, seed: int = 0) -> None:
        self.up = LineFaults(rates or FaultRates(), 2 * seed)
        self.down = LineFaults(rates or FaultRates(), 2 * seed + 1)
        self.disconnects = 0
        self._wanted_s: float | None = None
        self._cut: tuple[float, float] | None = None

    def set(self, direction: str = "both", **rates: float) -> None:
        """Change the named rates of "up", "down" or "both". Raises BadInput for a wrong name or value, without any
        change."""
        rate_names = {f.name for f in fields(FaultRates)}
        for name in rates.keys() - rate_names:
            raise BadInput("unknown line fault", expected=" | ".join(sorted(rate_names)), got=name)
        chosen = self._lines(direction)
        changed = [replace(line.rates, **rates) for line in chosen]
        for line, new in zip(chosen, changed, strict=True):
            line.rates = new

    def clear(self) -> None:
        """Set all rates to zero; a disconnection in progress continues to its end."""
        self.up.rates = self.down.rates = FaultRates()

    def disconnect(self, seconds: float) -> None:
        """Disconnect the line for ``seconds``, starting 0.2 s later, so that the report of the command can still be
        sent."""
        if not 0 < seconds <= MAX_DISCONNECT_S:
            raise BadInput(
                "disconnection is out of range", expected=f"above 0 – {MAX_DISCONNECT_S:g} s", got=f"{seconds:g} s"
            )
        self._wanted_s = seconds

    def connected(self, now_s: float) -> bool:
        """True if the line is connected. Also starts and ends disconnections; the terminal calls it in every
        iteration."""
        if self._wanted_s is not None:
            begin_s = now_s + LAST_WORDS_S
            self._cut, self._wanted_s = (begin_s, begin_s + self._wanted_s), None
            self.disconnects += 1
        if self._cut is None or now_s < self._cut[0]:
            return True
        if now_s < self._cut[1]:
            return False
        self._cut = None
        return True

    def _lines(self, direction: str) -> list[LineFaults]:
        lines = {"up": [self.up], "down": [self.down], "both": [self.up, self.down]}
        if direction not in lines:
            raise BadInput("unknown direction of the line", expected=" | ".join(lines), got=direction)
        return lines[direction]

"""Compares the server's clock with the monotonic clock. Jumps are reported, and daily jobs wait until the clock is
steady."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from datetime import datetime

from gss.operations.clock import Monotonic, Now
from gss.operations.events import EventBus

JUMP_S = 5.0
STEADY_AFTER_S = 3600.0


class ClockWatch:
    """Compares the clocks once a second. ``jumped``: functions called with the seconds of each jump, to correct stored
    times."""

    def __init__(
        self, bus: EventBus, now: Now, monotonic_s: Monotonic, jumped: Sequence[Callable[[float], None]]
    ) -> None:
        self._bus, self._now, self._monotonic_s, self._jumped = bus, now, monotonic_s, tuple(jumped)
        self._last: tuple[datetime, float] = (now(), monotonic_s())
        self._steady_from_s = self._last[1]
        self.last_jump_s: float | None = None
        """Size of the last jump in seconds, positive for a forward jump; None before the first jump."""

    def tick(self) -> None:
        """Compare the clocks. A jump is recorded and restarts the steady period."""
        now, mono_s = self._now(), self._monotonic_s()
        (before, before_s), self._last = self._last, (now, mono_s)
        jump_s = (now - before).total_seconds() - (mono_s - before_s)
        if abs(jump_s) <= JUMP_S:
            return
        self.last_jump_s, self._steady_from_s = jump_s, mono_s
        direction = "forward" if jump_s > 0 else "back"
        text = f"The server's clock jumped {direction} by {abs(jump_s):.1f} s; times before and after the jump cannot be compared"
        for put_right in self._jumped:
            put_right(jump_s)
        self._bus.record("clock", "warning", text, jump_s=round(jump_s, 3))

    def steady(self) -> bool:
        """True if the clock has run for an hour without a jump."""
        return self._monotonic_s() - self._steady_from_s >= STEADY_AFTER_S

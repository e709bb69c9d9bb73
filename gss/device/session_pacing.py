"""How many bytes may go out now, so that a command never waits behind a full buffer."""

from __future__ import annotations

BURST_S = 0.25


class Pacer:
    """Credit in bytes, filled at the line's own rate up to a burst. ``polled_s``: when it was filled last."""

    def __init__(self) -> None:
        self.polled_s: float | None = None
        self._credit_bytes = 0.0

    def restart(self, now_s: float) -> None:
        """A port was opened."""
        self.polled_s, self._credit_bytes = now_s, 0.0

    def refill(self, now_s: float, bytes_per_s: float | None) -> None:
        """Time has passed."""
        elapsed_s = now_s - (self.polled_s if self.polled_s is not None else now_s)
        self.polled_s = now_s
        if bytes_per_s is not None:
            self._credit_bytes = min(self._credit_bytes + bytes_per_s * elapsed_s, bytes_per_s * BURST_S)

    def spend(self, sent_bytes: int) -> None:
        """Bytes went out; urgent ones may overdraw."""
        self._credit_bytes -= sent_bytes

    @property
    def open(self) -> bool:
        """May more go out?"""
        return self._credit_bytes > 0

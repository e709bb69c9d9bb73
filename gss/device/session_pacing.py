"""Limit the number of bytes sent at a time, so that a command never waits for a full output buffer."""

from __future__ import annotations

BURST_S = 0.25


class Pacer:
    """Token bucket in bytes. It is refilled at the line rate, up to the size of a burst. ``polled_s``: time of the last
    refill."""

    def __init__(self) -> None:
        self.polled_s: float | None = None
        self._credit_bytes = 0.0

    def restart(self, now_s: float) -> None:
        """Start with an empty bucket on a newly opened port."""
        self.polled_s, self._credit_bytes = now_s, 0.0

    def refill(self, now_s: float, bytes_per_s: float | None) -> None:
        """Add the credit for the time since the last call. At an unknown rate the credit remains 0."""
        elapsed_s = now_s - (self.polled_s if self.polled_s is not None else now_s)
        self.polled_s = now_s
        if bytes_per_s is None:
            # Otherwise sent bytes would add up to a debt, which delays chunks once the rate is known.
            self._credit_bytes = 0.0
        else:
            self._credit_bytes = min(self._credit_bytes + bytes_per_s * elapsed_s, bytes_per_s * BURST_S)

    def spend(self, sent_bytes: int) -> None:
        """Subtract sent bytes. Urgent packets can make the credit negative."""
        self._credit_bytes -= sent_bytes

    @property
    def open(self) -> bool:
        """True if more bytes may be sent now."""
        return self._credit_bytes > 0

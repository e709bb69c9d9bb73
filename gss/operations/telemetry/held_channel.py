"""Detects missing housekeeping that is caused by a transfer: the transfer occupies the channel on which the ground
requests housekeeping."""

from __future__ import annotations

from gss.operations.line.link import LinkService


class HeldChannel:
    """Stores the time at which a transfer last occupied the channel."""

    def __init__(self, link: LinkService) -> None:
        self._link, self._held_s = link, float("-inf")

    def held_within(self, seconds: float) -> bool:
        """True if a transfer occupied the channel and the sensor answered within the last ``seconds``. Must be called
        regularly."""
        now_s, last_s = self._link.monotonic_s(), self._link.counters.last_good_s
        if self._link.session.transfers.holds_channel:
            self._held_s = now_s
        return last_s is not None and now_s - last_s < seconds and now_s - self._held_s < seconds

"""Detects missing housekeeping on an open line, and distinguishes a silent sensor from one that answers without sending
housekeeping, for example in its bootloader."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

from gss.operations.clock import Now, after_jump
from gss.operations.line.link import LinkService
from gss.operations.telemetry.alarm_text import NO_STATUS, SIGNAL
from gss.operations.telemetry.held_channel import HeldChannel
from gss.operations.telemetry.limit_check import Key
from gss.operations.telemetry.telemetry import TelemetryService

SIGNAL_LOST_AFTER_S = 5.0


@dataclass(frozen=True)
class Silence:
    """Whether housekeeping is missing for one reason. ``key``: alarm of this reason; ``silent_s``: time since the last
    housekeeping, or since the line was opened."""

    key: Key
    missing: bool
    silent_s: float
    limit: str
    text: str


class SilenceCheck:
    """Compares the times of the last housekeeping and of the last valid packet with the limit."""

    def __init__(self, link: LinkService, telemetry: TelemetryService, now: Now) -> None:
        self._link, self._telemetry, self._now = link, telemetry, now
        self._contact: tuple[int | None, datetime] = (None, now())
        self._no_answer = now()
        self._channel = HeldChannel(link)

    def clock_jumped(self, now: datetime, jump_s: float) -> None:
        """Correct the stored times after the server's clock jumped by ``jump_s``."""
        self._contact = (self._contact[0], after_jump(self._contact[1], now, jump_s))
        self._no_answer = after_jump(self._no_answer, now, jump_s)

    def check(self) -> tuple[Silence, Silence]:
        """Return the state of both reasons. Called about once a second."""
        now, contact_id = self._now(), self._link.contact_id if self._link.connected else None
        if contact_id != self._contact[0]:
            self._contact = (contact_id, now)
        newest = self._telemetry.board.latest(self._link.roles.quantities.status.packet)
        last_received = self._contact[1] if newest is None else max(newest[0], self._contact[1])
        silent_s, paused = (now - last_received).total_seconds(), self._channel.held_within(SIGNAL_LOST_AFTER_S)
        lost = contact_id is not None and silent_s > SIGNAL_LOST_AFTER_S and not paused
        good_s = self._link.counters.last_good_s
        if good_s is None or self._link.monotonic_s() - good_s > SIGNAL_LOST_AFTER_S:
            self._no_answer = now
        answers_s = (now - self._no_answer).total_seconds()
        value, after = round(silent_s, 1), f"for {SIGNAL_LOST_AFTER_S:g} s"
        return (
            Silence(
                SIGNAL,
                lost and answers_s == 0,
                value,
                f"no housekeeping {after}",
                f"Loss of signal: no housekeeping for {value:g} s",
            ),
            Silence(
                NO_STATUS,
                lost and answers_s > SIGNAL_LOST_AFTER_S,
                value,
                f"{after}, although the sensor answers",
                f"No housekeeping for {value:g} s, although the sensor answers",
            ),
        )

"""The two clocks. Everything that needs the time is given one of these, so that tests own it."""

from __future__ import annotations

import time
from collections.abc import Callable
from datetime import UTC, datetime, timedelta

Now = Callable[[], datetime]
Monotonic = Callable[[], float]
ONE_SECOND = timedelta(seconds=1)


def utc_now() -> datetime:
    """The moment, in UTC."""
    return datetime.now(UTC)


def iso_z(moment: datetime, timespec: str = "milliseconds") -> str:
    """A moment as ISO 8601 with milliseconds, or as finely as said, and Z."""
    return moment.astimezone(UTC).isoformat(timespec=timespec).replace("+00:00", "Z")


monotonic_s: Monotonic = time.monotonic
"""Seconds that never jump."""

stopwatch_s: Monotonic = time.perf_counter
"""Seconds for timing a stage."""


def after_jump(moment: datetime, now: datetime, jump_s: float) -> datetime:
    """A moment that was read before the clock jumped, as the new clock would have told it; one that was read after it stays."""
    shifted = moment + timedelta(seconds=jump_s)
    before = shifted <= now + ONE_SECOND if jump_s > 0 else moment > now + ONE_SECOND
    return shifted if before else moment

"""The two clocks. Everything that needs the time is given one of these, so that tests own it."""

from __future__ import annotations

import time
from collections.abc import Callable
from datetime import UTC, datetime

Now = Callable[[], datetime]
Monotonic = Callable[[], float]


def utc_now() -> datetime:
    """The moment, in UTC."""
    return datetime.now(UTC)


def iso_z(moment: datetime) -> str:
    """A moment as ISO 8601 with milliseconds and Z."""
    return moment.astimezone(UTC).isoformat(timespec="milliseconds").replace("+00:00", "Z")


monotonic_s: Monotonic = time.monotonic
"""Seconds that never jump."""

stopwatch_s: Monotonic = time.perf_counter
"""Seconds for timing a stage."""

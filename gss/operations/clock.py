"""The server's clocks. Code that needs the time receives a clock as an argument, which lets tests and rehearsals control it.

*Mission time* is one :class:`Clock` that is passed to the wiring. Passes, procedures, telemetry, contacts, commands and
protocol timers use only this clock. A rehearsal replaces it with a clock that runs faster. *Machine time* is the clock of this
computer. Accounts, tokens, the audit log, jobs, backups, retention and thread watchdogs use it.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta

Now = Callable[[], datetime]
Monotonic = Callable[[], float]
ONE_SECOND = timedelta(seconds=1)
CLOCK_AHEAD = timedelta(minutes=5)
"""Tolerance for creation times in the future. A key with a later creation time was created while the clock was ahead,
and is invalid until that time."""


def utc_now() -> datetime:
    """Return the current time in UTC."""
    return datetime.now(UTC)


def utc_us() -> int:
    """Return the system time in microseconds since 1970."""
    return time.time_ns() // 1000


def iso_z(moment: datetime, timespec: str = "milliseconds") -> str:
    """Format a time as ISO 8601 in UTC with Z, by default with milliseconds."""
    return moment.astimezone(UTC).isoformat(timespec=timespec).replace("+00:00", "Z")


monotonic_s: Monotonic = time.monotonic
"""Monotonic seconds, not affected by changes of the system clock."""

stopwatch_s: Monotonic = time.perf_counter
"""High-resolution seconds for timing a stage."""

processor_s: Monotonic = time.thread_time
"""Processor time of the calling thread, in seconds."""


@dataclass(frozen=True)
class Clock:
    """Mission time, in UTC and as monotonic seconds. Both run at one rate."""

    now: Now
    monotonic_s: Monotonic


MACHINE_CLOCK = Clock(utc_now, monotonic_s)
"""Mission time of a server: the clock of the machine."""


def after_jump(moment: datetime, now: datetime, jump_s: float) -> datetime:
    """Convert a time that was read before a clock jump to the new clock. A time read after the jump is returned unchanged."""
    shifted = moment + timedelta(seconds=jump_s)
    before = shifted <= now + ONE_SECOND if jump_s > 0 else moment > now + ONE_SECOND
    return shifted if before else moment

"""Rate limits against password guessing. After a number of failures, the next attempt must wait. Each further failure
doubles the wait, up to a limit.

There is no lockout: after the wait, the correct password is accepted.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass

from gss.domain.errors import RateLimited
from gss.operations.clock import Monotonic

MAX_KEYS = 10_000


@dataclass(frozen=True)
class Brake:
    """A rate limit. ``free``: number of failures after which waits begin. The first wait is one second. Each further
    failure doubles the wait, up to ``longest_s``. ``forget_s``: time without a failure after which the count restarts
    at zero."""

    free: int
    longest_s: float
    forget_s: float = 900.0


BY_NAME = Brake(free=5, longest_s=30.0)
BY_ADDRESS = Brake(free=15, longest_s=60.0)
BY_TOKEN_ADDRESS = Brake(free=30, longest_s=60.0)


class Attempts:
    """Counts failures by key (a name or an address), for at most ``MAX_KEYS`` keys. The oldest keys are dropped first."""

    def __init__(self, monotonic_s: Monotonic) -> None:
        self._now_s = monotonic_s
        self._failures: OrderedDict[str, tuple[int, float]] = OrderedDict()
        self._lock = threading.Lock()

    def begin(self, keys: Sequence[tuple[str, Brake]]) -> None:
        """Start an attempt. Raises RateLimited during a wait. The attempt counts as a failure until ``passed`` is called, so
        concurrent attempts cannot bypass the limit."""
        with self._lock:
            wait_s = max((self._wait_s(key, brake) for key, brake in keys), default=0.0)
            if wait_s > 0:
                raise RateLimited(
                    "too many failed sign-in attempts",
                    expected=f"a wait of {wait_s:.0f} s before the next attempt",
                    hint="try again later. If you forgot the password, ask an admin to reset it, or run: gss user password NAME",
                    retry_after_s=wait_s,
                )
            for key, brake in keys:
                count, _ = self._recent(key, brake)
                self._failures[key] = (count + 1, self._now_s())
                self._failures.move_to_end(key)
            while len(self._failures) > MAX_KEYS:
                self._failures.popitem(last=False)

    def passed(self, keys: Sequence[tuple[str, Brake]]) -> None:
        """Remove a successful attempt from the count. Other failures from the same address still count, so a user cannot use a
        valid account to guess the passwords of other users without a limit."""
        with self._lock:
            for key, _ in keys:
                count, at_s = self._failures.pop(key, (0, 0.0))
                if count > 1:
                    self._failures[key] = (count - 1, at_s)

    def forget(self, key: str) -> None:
        """Reset the failures of a key."""
        with self._lock:
            self._failures.pop(key, None)

    def _recent(self, key: str, brake: Brake) -> tuple[int, float]:
        """Return the number of failures of a key and the time of the last one; (0, 0) without a failure in ``forget_s``."""
        count, at_s = self._failures.get(key, (0, 0.0))
        return (0, 0.0) if self._now_s() - at_s >= brake.forget_s else (count, at_s)

    def _wait_s(self, key: str, brake: Brake) -> float:
        count, at_s = self._recent(key, brake)
        if count < brake.free:
            return 0.0
        return at_s + min(brake.longest_s, 2.0 ** min(count - brake.free, 20)) - self._now_s()

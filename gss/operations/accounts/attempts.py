"""Brakes for guessing: after some free failures each further one makes the next try wait longer, up to a limit.

There is no lock: a wait ends by itself, and whoever knows the password gets in after it.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Sequence
from dataclasses import dataclass

from gss.domain.errors import TooOften
from gss.operations.clock import Monotonic

MOST_KEYS = 10_000


@dataclass(frozen=True)
class Brake:
    """``free`` failures cost nothing; then the wait doubles from one second to ``longest_s``; ``forget_s`` after the last
    failure all is forgotten."""

    free: int
    longest_s: float
    forget_s: float = 900.0


BY_NAME = Brake(free=5, longest_s=30.0)
BY_ADDRESS = Brake(free=15, longest_s=60.0)
BY_TOKEN_ADDRESS = Brake(free=30, longest_s=60.0)


class Attempts:
    """Counts failures by key (a name, an address). Bounded: the oldest keys go first."""

    def __init__(self, monotonic_s: Monotonic) -> None:
        self._now_s = monotonic_s
        self._failures: OrderedDict[str, tuple[int, float]] = OrderedDict()
        self._lock = threading.Lock()

    def begin(self, keys: Sequence[tuple[str, Brake]]) -> None:
        """A try begins: TooOften while a wait is on. It counts as failed until ``passed``, so that many tries at once
        do not slip through before the first has failed."""
        with self._lock:
            wait_s = max((self._wait_s(key, brake) for key, brake in keys), default=0.0)
            if wait_s > 0:
                raise TooOften(
                    "too many tries failed",
                    expected=f"the next try in {wait_s:.0f} s",
                    hint="wait; a forgotten password is set anew by an admin, or in the shell: gss user password NAME",
                    retry_after_s=wait_s,
                )
            for key, brake in keys:
                count, _ = self._known(key, brake)
                self._failures[key] = (count + 1, self._now_s())
                self._failures.move_to_end(key)
            while len(self._failures) > MOST_KEYS:
                self._failures.popitem(last=False)

    def passed(self, keys: Sequence[tuple[str, Brake]]) -> None:
        """It was right: this try did not count. Others of the same address still do: one's own account is no key to them."""
        with self._lock:
            for key, _ in keys:
                count, at_s = self._failures.pop(key, (0, 0.0))
                if count > 1:
                    self._failures[key] = (count - 1, at_s)

    def forget(self, key: str) -> None:
        """Nothing failed under this key."""
        with self._lock:
            self._failures.pop(key, None)

    def _known(self, key: str, brake: Brake) -> tuple[int, float]:
        count, at_s = self._failures.get(key, (0, 0.0))
        return (0, 0.0) if self._now_s() - at_s >= brake.forget_s else (count, at_s)

    def _wait_s(self, key: str, brake: Brake) -> float:
        count, at_s = self._known(key, brake)
        if count < brake.free:
            return 0.0
        return at_s + min(brake.longest_s, 2.0 ** min(count - brake.free, 20)) - self._now_s()

"""Passwords: hashing with argon2id (RFC 9106), and rules for new passwords. The rules follow NIST SP 800-63B §5.1.1.2: they
require a minimum length but no types of characters."""

from __future__ import annotations

import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

import argon2

from gss.domain.errors import BadInput, RateLimited
from gss.operations.accounts.guessable import LONGEST, normalized, why_guessable

SHORTEST = 10
AT_ONCE = 2
"""Maximum number of concurrent hash computations. Each one needs tens of megabytes, so without this limit anonymous clients could
exhaust the memory."""
MAX_WAITING = 20
"""Maximum number of waiting sign-ins. Further sign-ins are rejected immediately, so a flood of requests does not delay others
for minutes."""
Done = TypeVar("Done")


class HashingPool:
    """Thread pool for password hashing. Other requests, in particular ABORT, do not wait for a hash."""

    def __init__(self, at_once: int = AT_ONCE, max_waiting: int = MAX_WAITING) -> None:
        self._threads = ThreadPoolExecutor(at_once, thread_name_prefix="passwords")
        self._places = threading.BoundedSemaphore(at_once + max_waiting)

    def take(self, work: Callable[[], Done]) -> Future[Done]:
        """Queue ``work`` and return its future. Raises RateLimited if too many sign-ins are waiting."""
        if not self._places.acquire(blocking=False):
            raise RateLimited("too many sign-ins are in progress", hint="try again in 2 s", retry_after_s=2.0)
        future = self._threads.submit(work)
        future.add_done_callback(lambda _: self._places.release())
        return future


class Passwords:
    """Hashes and verifies passwords. ``passes``, ``memory_kib``, ``lanes``: cost parameters of a hash."""

    def __init__(self, passes: int = 3, memory_kib: int = 65_536, lanes: int = 4) -> None:
        self._hasher = argon2.PasswordHasher(
            time_cost=passes, memory_cost=max(memory_kib, 8 * lanes), parallelism=lanes
        )
        self._gate = threading.BoundedSemaphore(AT_ONCE)
        self._dummy_hash = ""
        self.turns = HashingPool()
        self.verified = 0

    def hash(self, password: str) -> str:
        """Return the hash of a password for storage."""
        with self._gate:
            return self._hasher.hash(normalized(password))

    def verify(self, stored: str, password: str) -> bool:
        """True if the password matches the stored hash. If ``stored`` is "", a hash is still computed, so that the response time
        does not show whether a user exists."""
        self._dummy_hash = self._dummy_hash or self.hash("password of an unknown user")
        with self._gate:
            self.verified += 1
            try:
                self._hasher.verify(stored or self._dummy_hash, normalized(password))
            except (argon2.exceptions.VerificationError, argon2.exceptions.InvalidHashError):
                return False
        return bool(stored)

    def outdated(self, stored: str) -> bool:
        """True if the hash was computed with cost parameters that differ from the current ones."""
        return self._hasher.check_needs_rehash(stored)

    @staticmethod
    def check_new(password: str, name: str) -> None:
        """Raise BadInput if a new password is not acceptable. Messages never contain the password."""
        normal_form = normalized(password)
        if not SHORTEST <= len(normal_form) <= LONGEST:
            raise BadInput(
                "invalid password length",
                expected=f"{SHORTEST} – {LONGEST} characters",
                got=f"{len(normal_form)} characters",
                hint="use four or five unrelated words",
            )
        reason = why_guessable(normal_form, name)
        if reason:
            raise BadInput(
                "this password is too easy to guess",
                expected="a password without common words, names, sequences or repetition",
                got=reason,
                hint="use four or five unrelated words",
            )

"""Passwords: argon2id (RFC 9106), rules after NIST SP 800-63B §5.1.1.2: length counts, composition does not."""

from __future__ import annotations

import threading
import unicodedata
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

import argon2

from gss.domain.errors import BadInput, TooOften

SHORTEST, LONGEST = 10, 200
AT_ONCE = 2
"""Each hashing takes tens of megabytes: more at the same time would let strangers fill the memory."""
MOST_WAITING = 20
"""More are told at once to come again: whoever floods the door must not make the others wait for minutes."""
Done = TypeVar("Done")
KNOWN = frozenset(
    """password password1 password12 password123 passw0rd123 1234567890 12345678910 123456789a qwertyuiop qwerty1234
    qwerty12345 1q2w3e4r5t administrator changeme123 letmein1234 iloveyou12 welcome123 startracker star-tracker
    groundstation adminadmin""".split()  # noqa: SIM905 - a list to read
)


class Turns:
    """Threads of their own for what computes a hash, so that nothing else ever waits for one: ABORT least of all."""

    def __init__(self, at_once: int = AT_ONCE, most_waiting: int = MOST_WAITING) -> None:
        self._threads = ThreadPoolExecutor(at_once, thread_name_prefix="passwords")
        self._places = threading.BoundedSemaphore(at_once + most_waiting)

    def take(self, work: Callable[[], Done]) -> Future[Done]:
        """What ``work`` will return; TooOften at once while too many wait."""
        if not self._places.acquire(blocking=False):
            raise TooOften(
                "too many are signing in now", expected="the next try in 2 s", hint="wait", retry_after_s=2.0
            )
        turn = self._threads.submit(work)
        turn.add_done_callback(lambda _: self._places.release())
        return turn


class Passwords:
    """Hashes and verifies. ``passes`` and ``memory_kib`` are the cost of each guess."""

    def __init__(self, passes: int = 3, memory_kib: int = 65_536, lanes: int = 4) -> None:
        self._hasher = argon2.PasswordHasher(
            time_cost=passes, memory_cost=max(memory_kib, 8 * lanes), parallelism=lanes
        )
        self._gate = threading.BoundedSemaphore(AT_ONCE)
        self._nobody = ""
        self.turns = Turns()
        self.verified = 0

    def hash(self, password: str) -> str:
        """What is stored."""
        with self._gate:
            return self._hasher.hash(_normal(password))

    def verify(self, stored: str, password: str) -> bool:
        """Does it fit? With nothing stored a hash is computed all the same: an unknown name must not answer sooner."""
        self._nobody = self._nobody or self.hash("the password of nobody")
        with self._gate:
            self.verified += 1
            try:
                self._hasher.verify(stored or self._nobody, _normal(password))
            except (argon2.exceptions.VerificationError, argon2.exceptions.InvalidHashError):
                return False
        return bool(stored)

    def outdated(self, stored: str) -> bool:
        """Was it hashed at another cost than today's?"""
        return self._hasher.check_needs_rehash(stored)

    @staticmethod
    def check_new(password: str, name: str) -> None:
        """BadInput unless it may become a password. The password itself is in no message."""
        words = _normal(password)
        if not SHORTEST <= len(words) <= LONGEST:
            raise BadInput(
                "the password has not the right length",
                expected=f"{SHORTEST} – {LONGEST} characters",
                got=f"{len(words)} characters",
                hint="four or five words that have nothing to do with each other",
            )
        if len(set(words)) < 5 or words.lower() in KNOWN or name.lower() in (words.lower(), words[::-1].lower()):
            raise BadInput(
                "this password would be guessed first",
                expected="none of the usual ones, not the name, not one character repeated",
                hint="four or five words that have nothing to do with each other",
            )


def _normal(password: str) -> str:
    """One form for what looks the same; what is far too long is cut where the rule would refuse it anyway."""
    return unicodedata.normalize("NFKC", password[: 2 * LONGEST])

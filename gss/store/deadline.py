"""Calls of a remote store with an overall deadline.

The client libraries limit each step of a request, but not the whole: resolving a name, connecting, retries and a response that
trickles add up to minutes.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

from gss.domain.errors import StoreDown

T = TypeVar("T")
UNFINISHED_MOST = 16
PAUSE_S = 5.0
"""After a call that reached its deadline, further calls fail at once for this time."""


class DeadlineCalls:
    """Runs each call on a thread and stops waiting for it after ``limit_s``.

    A thread cannot be stopped: it ends when its library gives up. At most ``UNFINISHED_MOST`` of them run at a time.
    """

    def __init__(self, limit_s: float, monotonic_s: Callable[[], float] = time.monotonic) -> None:
        self._limit_s, self._monotonic_s = limit_s, monotonic_s
        self._free = threading.BoundedSemaphore(UNFINISHED_MOST)
        self._down_until_s = float("-inf")

    def run(self, work: Callable[[], T], extra_s: float = 0.0) -> T:
        """Return what ``work`` returns. Raises its error, or StoreDown after ``limit_s`` + ``extra_s``."""
        limit_s = self._limit_s + extra_s
        if self._monotonic_s() < self._down_until_s or not self._free.acquire(blocking=False):
            raise self._down("it did not respond to an earlier request", limit_s)
        call: Future[T] = Future()
        threading.Thread(target=self._into, args=(call, work), name="store call", daemon=True).start()
        try:
            result = call.result(limit_s)
        except TimeoutError:
            if call.done():  # the work itself raised TimeoutError
                raise
            self._down_until_s = self._monotonic_s() + PAUSE_S
            raise self._down("no response", limit_s) from None
        self._down_until_s = float("-inf")
        return result

    def _into(self, call: Future[T], work: Callable[[], T]) -> None:
        try:
            call.set_result(work())
        except BaseException as error:  # raised again by call.result()
            call.set_exception(error)
        finally:
            self._free.release()

    @staticmethod
    def _down(got: str, limit_s: float) -> StoreDown:
        return StoreDown(
            "no response from the blob store",
            expected=f"a complete response within {limit_s:g} s",
            got=got,
            hint="check the store and its network",
        )

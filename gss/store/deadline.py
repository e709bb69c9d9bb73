"""Calls to a remote store with an overall deadline.

The client libraries limit the duration of each step of a request but not the total: name resolution, connection,
retries and a slow response can add up to minutes.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

from gss.domain.errors import StoreDown

T = TypeVar("T")
MAX_UNFINISHED = 16
PAUSE_S = 5.0
"""Time for which further calls fail immediately after a call has reached its deadline."""


class DeadlineCalls:
    """Runs each call on a separate thread and stops waiting for it after ``limit_s``.

    A thread cannot be stopped; it ends when its library reports an error. At most ``MAX_UNFINISHED`` of these threads
    run at the same time.
    """

    def __init__(self, limit_s: float, monotonic_s: Callable[[], float] = time.monotonic) -> None:
        self._limit_s, self._monotonic_s = limit_s, monotonic_s
        self._free = threading.BoundedSemaphore(MAX_UNFINISHED)
        self._down_until_s = float("-inf")

    def run(self, work: Callable[[], T], extra_s: float = 0.0) -> T:
        """Return the result of ``work``. Raises the error of ``work``, or StoreDown after ``limit_s`` + ``extra_s``."""
        limit_s = self._limit_s + extra_s
        if self._monotonic_s() < self._down_until_s or not self._free.acquire(blocking=False):
            raise self._down("it did not respond to an earlier request", limit_s)
        call: Future[T] = Future()
        threading.Thread(target=self._complete, args=(call, work), name="store call", daemon=True).start()
        try:
            result = call.result(limit_s)
        except TimeoutError:
            if call.done():  # the work itself raised TimeoutError
                raise
            self._down_until_s = self._monotonic_s() + PAUSE_S
            raise self._down("no response", limit_s) from None
        self._down_until_s = float("-inf")
        return result

    def _complete(self, call: Future[T], work: Callable[[], T]) -> None:
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

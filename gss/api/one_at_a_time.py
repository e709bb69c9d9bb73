"""Run slow, exclusive work on its own thread, outside the request thread pool."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

from gss.domain.errors import Conflict

T = TypeVar("T")


class OneAtATime:
    """Runs one call at a time on a new thread. A second call is rejected, not queued. ``busy``: message of the
    error."""

    def __init__(self, name: str, busy: str, hint: str) -> None:
        self._name, self._busy, self._hint = name, busy, hint
        self._lock = threading.Lock()

    async def run(self, call: Callable[[], T]) -> T:
        """Run the call and return its result. Raises Conflict while another call runs, even if that call's client has
        disconnected."""
        if not self._lock.acquire(blocking=False):
            raise Conflict(self._busy, hint=self._hint)
        result: Future[T] = Future()
        result.set_running_or_notify_cancel()  # the thread finishes even if the client disconnects
        try:
            threading.Thread(target=self._work, args=(call, result), name=self._name, daemon=True).start()
        except RuntimeError:
            self._lock.release()
            raise
        return await asyncio.wrap_future(result)

    def _work(self, call: Callable[[], T], result: Future[T]) -> None:
        try:
            answer = call()
        except BaseException as error:  # raised again where the result is awaited
            self._lock.release()
            result.set_exception(error)
        else:
            self._lock.release()
            result.set_result(answer)

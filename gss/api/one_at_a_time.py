"""A thread apart from those of other requests, for work that may take seconds and makes no sense twice at a time."""

from __future__ import annotations

import asyncio
import threading
from collections.abc import Callable
from concurrent.futures import Future
from typing import TypeVar

from gss.domain.errors import Conflict

T = TypeVar("T")


class OneAtATime:
    """Runs one call at a time on a new thread. A second call is refused, not queued. ``busy``: the reason in words."""

    def __init__(self, name: str, busy: str, hint: str) -> None:
        self._name, self._busy, self._hint = name, busy, hint
        self._lock = threading.Lock()

    async def run(self, call: Callable[[], T]) -> T:
        """The call's result. Conflict while another one runs, even one whose client has gone."""
        if not self._lock.acquire(blocking=False):
            raise Conflict(self._busy, hint=self._hint)
        result: Future[T] = Future()
        result.set_running_or_notify_cancel()  # the thread ends its work whether or not a client still waits
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

"""Lock of the host session. A driver that hangs never releases it, so only the line thread waits for it without a limit."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import TracebackType

from gss.domain.errors import Conflict

LOCK_WITHIN_S = 10.0
"""Maximum time that a thread waits for the session. The session is normally held for some milliseconds."""
FOREVER = -1.0
NOTHING_SENT = "nothing was sent"


class SessionLock:
    """Reentrant lock. ``with lock`` raises Conflict if the session is not free within ``LOCK_WITHIN_S``."""

    def __init__(self) -> None:
        self._lock = threading.RLock()

    @contextmanager
    def within(self, seconds: float, consequence: str = NOTHING_SENT) -> Iterator[None]:
        """Hold the lock during the block. Raises Conflict with the ``consequence`` if it is not free within ``seconds``."""
        self._acquire(seconds, consequence)
        try:
            yield
        finally:
            self._lock.release()

    def __enter__(self) -> None:
        self._acquire(LOCK_WITHIN_S, NOTHING_SENT)

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._lock.release()

    def _acquire(self, seconds: float, consequence: str) -> None:
        if not self._lock.acquire(timeout=seconds):
            raise Conflict(
                f"{consequence}: the driver of the instrument has not responded for {seconds:g} s",
                hint="restart the unit on the page Fleet, or the server, if an alarm reports that the driver hangs",
            )

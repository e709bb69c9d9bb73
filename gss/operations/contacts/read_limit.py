"""Limits the number of requests that read whole contacts at the same time, because reading a long contact takes seconds
and much memory."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager

from gss.domain.errors import Busy


class ReadLimit:
    """Permits up to ``max_readers`` threads to read at the same time. A further thread waits up to ``wait_s`` seconds."""

    def __init__(self, max_readers: int = 2, wait_s: float = 15.0) -> None:
        self._max_readers, self._wait_s = max_readers, wait_s
        self._readers = threading.BoundedSemaphore(max_readers)

    @contextmanager
    def reading(self) -> Iterator[None]:
        """Count the calling thread as a reader within the block. Raises Busy after the wait."""
        if not self._readers.acquire(timeout=self._wait_s):
            raise Busy(
                "Too many requests read contacts at the same time",
                expected=f"at most {self._max_readers}",
                hint="Try again.",
                retry_after_s=self._wait_s,
            )
        try:
            yield
        finally:
            self._readers.release()

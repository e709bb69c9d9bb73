"""Queue of writes to the store. Their order is preserved while the store is down."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable

from gss.domain.errors import StoreDown

log = logging.getLogger("gss.store")


class DeferredWrites:
    """A queue of writes. Each write must be atomic: if a write raises StoreDown, the next ``run`` repeats this write
    first. Not thread-safe; only the dispatch thread uses it."""

    def __init__(self) -> None:
        self._writes: deque[Callable[[], object]] = deque()

    def add(self, write: Callable[[], object]) -> None:
        """Append a write."""
        self._writes.append(write)

    def run(self) -> None:
        """Call the writes until the queue is empty or the store is down. If a write raises another error, drop the write and
        raise the error. The next ``run`` then continues with the later writes."""
        while self._writes:
            try:
                self._writes[0]()
            except StoreDown as error:
                log.warning("%d writes are waiting for the store: %s", len(self._writes), error)
                return
            except BaseException:
                self._writes.popleft()
                raise
            self._writes.popleft()

"""Queue of writes to the store, kept in order while the store is down."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable

from gss.domain.errors import StoreDown

log = logging.getLogger("gss.store")


class DeferredWrites:
    """A queue of writes. Each write must be atomic: one that raises StoreDown is repeated by the next ``run`` before the
    later ones. Not thread-safe: used on the dispatch thread."""

    def __init__(self) -> None:
        self._writes: deque[Callable[[], object]] = deque()

    def add(self, write: Callable[[], object]) -> None:
        """Append a write."""
        self._writes.append(write)

    def run(self) -> None:
        """Call the writes until none is left or the store is down. If a write raises another error, drop it and raise the
        error; the next ``run`` continues with the later writes."""
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

"""Writes to the store in their order, kept while the store is down."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable

from gss.domain.errors import StoreDown

log = logging.getLogger("gss.store")


class DeferredWrites:
    """A queue of writes. Each must be all or nothing: one that raises StoreDown is called again by the next ``run``, before those
    after it. Not thread-safe: used on the dispatch thread."""

    def __init__(self) -> None:
        self._writes: deque[Callable[[], object]] = deque()

    def add(self, write: Callable[[], object]) -> None:
        """Append a write."""
        self._writes.append(write)

    def run(self) -> None:
        """Call the writes until none is left or the store is down. A write that raises anything else is dropped, and its error is
        raised; the rest follow with the next ``run``."""
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

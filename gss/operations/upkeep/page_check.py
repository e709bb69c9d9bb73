"""The pages of a large SQLite file: reading them all before the start would keep everybody waiting; it is done beside the work."""

from __future__ import annotations

import logging
import threading

from gss.domain.errors import StoreDown
from gss.operations.events import EventBus
from gss.store.engine import Database, damaged_pages, is_large

log = logging.getLogger("gss.upkeep")


class PageCheck:
    """Reads them once, on a thread of its own. ``state``: words for the health page; "" where the start has read them."""

    def __init__(self, database: Database, bus: EventBus) -> None:
        self._database, self._bus = database, bus
        self.state = ""
        self._thread = threading.Thread(target=self._read, name="pages", daemon=True)

    def start(self) -> None:
        """Begin, where the start left it out."""
        if is_large(self._database.engine):
            self.state = "its pages are being read"
            self._thread.start()

    def wait(self) -> None:
        """Until it has ended."""
        if self._thread.is_alive():
            self._thread.join()

    def _read(self) -> None:
        try:
            found = damaged_pages(self._database.engine)
        except StoreDown as error:
            log.warning("the pages of the database were not read: %s", error)
            self.state = "its pages could not be read to the end"
            return
        self.state = "its pages were read after the start"
        if found:
            self._database.damage = found
            self._bus.record("upkeep", "critical", f"the database is damaged: {found}")

"""Reads all pages of a large SQLite file in the background, because reading them at startup would delay the server."""

from __future__ import annotations

import logging
import threading

from gss.domain.errors import StoreDown
from gss.operations.events import EventBus
from gss.store.engine import Database, damaged_pages, is_large

log = logging.getLogger("gss.upkeep")


class PageCheck:
    """Reads all pages once, on a background thread. ``state``: text for the health page; "" if the startup has read the
    pages."""

    def __init__(self, database: Database, bus: EventBus) -> None:
        self._database, self._bus = database, bus
        self.state = ""
        self._thread = threading.Thread(target=self._read, name="pages", daemon=True)

    def start(self) -> None:
        """Start the background thread if the startup skipped the check."""
        if is_large(self._database.engine):
            self.state = "its pages are being checked"
            self._thread.start()

    def wait(self) -> None:
        """Wait until the check has ended."""
        if self._thread.is_alive():
            self._thread.join()

    def _read(self) -> None:
        try:
            damaged = damaged_pages(self._database.engine)
        except StoreDown as error:
            log.warning("the pages of the database were not checked: %s", error)
            self.state = "its pages could not be read completely"
            return
        self.state = "its pages were checked after the start"
        if damaged:
            self._database.report_damage(damaged)
            self._bus.record("upkeep", "critical", f"The database is damaged: {damaged}")

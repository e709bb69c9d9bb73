"""Bytes that a pass can bring down: the line's rate, less the share that is measured to go to headers, telemetry and repeats."""

from __future__ import annotations

from dataclasses import dataclass
from statistics import median

from gss.operations.line.link import LinkService
from gss.store import passes as store
from gss.store.engine import Database
from gss.store.models import Station

BITS_PER_BYTE = 10
"""Start and stop bit included."""
MEASURED_OVER = 20
MIN_BYTES = 4096
ASSUMED_SHARE = 0.8


@dataclass(frozen=True)
class LineBudget:
    """``bytes_s``: bytes on the line per second, None while the rate is not known. ``share``: of them, content of downloads;
    ``downloads``: number that it was measured from, 0: assumed."""

    bytes_s: float | None
    share: float
    downloads: int

    def content_bytes(self, seconds: float) -> int | None:
        """Content that fits in a time; None while the rate is not known."""
        return None if self.bytes_s is None else int(self.bytes_s * self.share * seconds)


class LineBudgetService:
    """Measures the share from the newest complete downloads."""

    def __init__(self, link: LinkService, database: Database) -> None:
        self._link, self._database = link, database

    def of(self, station: Station) -> LineBudget:
        """Return the budget of a station's line."""
        rate = station.line_baud or self._reported_baud()
        bytes_s = rate / BITS_PER_BYTE if rate else None
        with self._database.unit_of_work() as session:
            downloads = store.newest_downloads(session, MIN_BYTES, MEASURED_OVER)
        if bytes_s is None or not downloads:
            return LineBudget(bytes_s, ASSUMED_SHARE, 0)
        rates = [size / max(0.001, (finished - created).total_seconds()) for size, created, finished in downloads]
        return LineBudget(bytes_s, min(1.0, median(rates) / bytes_s), len(rates))

    def _reported_baud(self) -> int:
        hello = self._link.last_hello
        return hello.line_baud if hello is not None else 0

"""Amount of data that can be downloaded in a pass: the line rate multiplied by the measured fraction of download content. The
remaining fraction is used by headers, telemetry and repeated chunks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from statistics import median

from gss.operations.line.link import LinkService
from gss.store import passes as store
from gss.store.engine import Database
from gss.store.models import Station

BITS_PER_BYTE = 10
"""Bits on the line per byte, including start and stop bit."""
MEASURED_OVER = 20
MIN_BYTES = 4096
ASSUMED_SHARE = 0.8


@dataclass(frozen=True)
class LineBudget:
    """Data rate of a line. ``bytes_s``: bytes per second on the line, None if the rate is unknown. ``share``: fraction of these
    bytes that is download content. ``downloads``: number of downloads from which ``share`` was measured; 0 if it is assumed."""

    bytes_s: float | None
    share: float
    downloads: int

    def content_bytes(self, seconds: float) -> int | None:
        """Return the number of content bytes that can be downloaded in a time, None if the rate is unknown."""
        return None if self.bytes_s is None else int(self.bytes_s * self.share * seconds)


class LineBudgetService:
    """Measures the fraction of download content from the latest complete downloads over a station's line."""

    def __init__(self, link: LinkService, database: Database) -> None:
        self._link, self._database = link, database

    def of(self, station: Station) -> LineBudget:
        """Return the budget of a station's line."""
        rate = station.line_baud or self._reported_baud()
        bytes_s = rate / BITS_PER_BYTE if rate else None
        with self._database.unit_of_work() as session:
            downloads = store.newest_downloads(session, MIN_BYTES, MEASURED_OVER, station.line_url)
        shares = [] if bytes_s is None else [rate / bytes_s for rate in _rates(downloads) if rate <= bytes_s]
        return LineBudget(bytes_s, median(shares) if shares else ASSUMED_SHARE, len(shares))

    def _reported_baud(self) -> int:
        hello = self._link.last_hello
        return hello.line_baud if hello is not None else 0


def _rates(downloads: Sequence[tuple[int, datetime, datetime]]) -> list[float]:
    """Return the bytes per second of each (size, created, finished). A download waits until the one before has finished. A rate
    above that of the line means that most of the content was already stored."""
    rates, free = [], datetime.min.replace(tzinfo=UTC)
    for size, created, finished in sorted(downloads, key=lambda download: download[2]):
        rates.append(size / max(0.001, (finished - max(created, free)).total_seconds()))
        free = finished
    return rates

"""The pass report: statistics of one contact."""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import timedelta

from gss.operations.contacts.contacts import ContactDetail, ContactService
from gss.operations.contacts.gaps import Count, RecordCheck
from gss.operations.telemetry.archive import Archive, TelemetrySeries
from gss.store import telemetry as store
from gss.store.engine import Database

PLOTTED = (
    "housekeeping.stars_matched",
    "attitude.sigma_cross_arcsec",
    "housekeeping.rate_deg_s",
    "housekeeping.sensor_temperature_c",
)
POINTS = 400


@dataclass(frozen=True)
class AttitudeSummary:
    """Statistics of the sensor's attitude solutions. ``first``, ``last``: (ra, dec, roll) in degrees of the first and last
    solved iteration."""

    iterations: int
    solved: int
    sigma_cross_arcsec_median: float | None
    first: tuple[float, float, float] | None
    last: tuple[float, float, float] | None

    @property
    def share(self) -> float | None:
        """Fraction of iterations that were solved, None without iterations."""
        return self.solved / self.iterations if self.iterations else None


@dataclass(frozen=True)
class ContactReport:
    """Content of the pass report. ``quality``: (Unix seconds, fraction of damaged packets since the previous count)."""

    detail: ContactDetail
    attitude: AttitudeSummary
    record: RecordCheck
    series: list[TelemetrySeries]
    quality: list[tuple[float, float]]
    telemetry_packets: int
    frame_bytes: int


def contact_report(contacts: ContactService, archive: Archive, database: Database, contact_id: int) -> ContactReport:
    """Return the report of a contact. Raises NotFound if the contact does not exist."""
    detail = contacts.detail(contact_id)
    start, end = detail.row.started, max(detail.end, detail.row.started + timedelta(seconds=1))
    return ContactReport(
        detail,
        _attitude(database, detail),
        contacts.record(contact_id),
        archive.history(PLOTTED, start, end, POINTS),
        quality(contacts.counts(contact_id)),
        sum(detail.packets.values()),
        detail.frame_bytes,
    )


def _attitude(database: Database, detail: ContactDetail) -> AttitudeSummary:
    names = ("outcome", "sigma_cross_arcsec", "ra_deg", "dec_deg", "roll_deg")
    rows = store.rows(database, "attitude", names, detail.row.started, detail.end, contact_id=detail.row.id)
    iterations = solved = 0
    sigmas: list[float] = []
    pointings: list[tuple[float, float, float]] = []
    for row in rows:
        outcome, sigma, *angles = row.values
        iterations += 1
        if outcome != "solved":
            continue
        solved += 1
        if sigma is not None:
            sigmas.append(float(sigma))
        if None not in angles:
            pointings[1:] = [(float(angles[0]), float(angles[1]), float(angles[2]))]
    median = statistics.median(sigmas) if sigmas else None
    first, last = (pointings[0], pointings[-1]) if pointings else (None, None)
    return AttitudeSummary(iterations, solved, median, first, last)


def quality(counts: Sequence[Count]) -> list[tuple[float, float]]:
    """Return (Unix seconds, fraction of damaged packets) for each interval between two counts in which packets were
    received."""
    damaged_fractions = []
    bad_before = good_before = 0.0
    for count in counts:
        bad = sum(count.values.get(name, 0.0) for name in ("bad_crc", "too_long", "too_short"))
        good = count.values.get("good", 0.0)
        new = (bad - bad_before) + (good - good_before)
        if new > 0:
            damaged_fractions.append((count.at_s, (bad - bad_before) / new))
        bad_before, good_before = bad, good
    return damaged_fractions

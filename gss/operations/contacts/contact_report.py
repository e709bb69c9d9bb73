"""The pass report: statistics of one contact."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import timedelta

import numpy as np

from gss.domain.frames import ra_dec_roll_rad
from gss.domain.rotation import matrix_from_quaternion
from gss.instruments.dictionary.definitions import Value
from gss.instruments.telemetry_roles import AttitudeRole, Quantities
from gss.operations.contacts.contacts import ContactDetail, ContactService
from gss.operations.contacts.gaps import Count, RecordCheck
from gss.operations.telemetry.archive import Archive, TelemetrySeries
from gss.operations.telemetry.last_attitude import SOLVED
from gss.store import telemetry as store
from gss.store.engine import Database

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
        _attitude(database, detail, contacts.quantities.attitude),
        contacts.record(contact_id),
        archive.history(plotted_fields(contacts.quantities), start, end, POINTS),
        quality(contacts.counts(contact_id)),
        sum(detail.packets.values()),
        detail.frame_bytes,
    )


def plotted_fields(quantities: Quantities) -> list[str]:
    """Return ``packet.field`` of the quantities that the report plots, without those that the sensor does not report."""
    status, attitude = quantities.status, quantities.attitude
    fields = (
        (status.packet, status.stars_matched),
        (attitude.packet, attitude.sigma_cross_arcsec),
        (status.packet, status.rate_deg_s),
        (status.packet, status.sensor_temperature),
    )
    return [f"{packet}.{field}" for packet, field in fields if packet and field]


def _attitude(database: Database, detail: ContactDetail, role: AttitudeRole) -> AttitudeSummary:
    names, started = tuple(dict.fromkeys(role.fields().values())), detail.row.started
    rows = store.rows(database, role.packet, names, started, detail.end, contact_id=detail.row.id) if names else ()
    iterations = solved = 0
    sigmas: list[float] = []
    pointings: list[tuple[float, float, float]] = []
    for row in rows:
        values = role.read(dict(zip(names, row.values, strict=True)))
        iterations += 1
        if str(values.get("outcome", SOLVED)) != SOLVED:
            continue
        solved += 1
        sigma, pointing = values.get("sigma_cross_arcsec"), _pointing_deg(values)
        if isinstance(sigma, int | float):
            sigmas.append(float(sigma))
        if pointing is not None:
            pointings[1:] = [pointing]
    median = statistics.median(sigmas) if sigmas else None
    first, last = (pointings[0], pointings[-1]) if pointings else (None, None)
    return AttitudeSummary(iterations, solved, median, first, last)


def _pointing_deg(values: Mapping[str, Value]) -> tuple[float, float, float] | None:
    """Return the reported (ra, dec, roll), or compute it from the quaternion if the angles are missing. Return None if
    both are missing."""
    angles = [values.get(name) for name in ("ra_deg", "dec_deg", "roll_deg")]
    ra_deg, dec_deg, roll_deg = (float(v) if isinstance(v, int | float) else math.nan for v in angles)
    if math.isfinite(ra_deg + dec_deg + roll_deg):
        return ra_deg, dec_deg, roll_deg
    components = [values.get(f"quaternion_{axis}") for axis in "xyzw"]
    quaternion = np.array([float(c) if isinstance(c, int | float) else math.nan for c in components])
    if not np.linalg.norm(quaternion) > 0:
        return None
    ra_rad, dec_rad, roll_rad = ra_dec_roll_rad(matrix_from_quaternion(quaternion))
    return math.degrees(ra_rad), math.degrees(dec_rad), math.degrees(roll_rad)


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

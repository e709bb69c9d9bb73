"""Catalogues in the flash banks, and the stars in each of their rows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from datetime import datetime

import numpy as np
from scipy.spatial import cKDTree

from gss.catalogue_tools.onboard import decode, read_header
from gss.domain.angles import ARCSEC_RAD
from gss.domain.errors import GssError
from gss.domain.stars import StarTable
from gss.instruments.registry import Registry
from gss.operations.clock import Now
from gss.operations.events import EventBus
from gss.operations.transfers.flash_banks import CATALOGUE, CATALOGUES, BankReport, FlashBanks
from gss.skytables.bank import OnboardCatalogue
from gss.store import catalogues as store
from gss.store.blobs import BlobStore
from gss.store.engine import Database
from gss.store.models import Catalogue

SAME_STAR_WITHIN_RAD = 300 * ARCSEC_RAD
UNKNOWN_HIP = -1


@dataclass(frozen=True)
class BankView:
    """A bank as reported by the device. ``catalogue``: catalogue with the same hash, None if the ground does not have
    it."""

    bank: str
    state: str
    active: bool
    stars: int | None
    pairs: int | None
    sha256: str | None
    catalogue: Catalogue | None


class BankService:
    """Combines the device's reports of catalogue banks with the stored catalogues."""

    def __init__(
        self,
        flash: FlashBanks,
        database: Database,
        blobs: BlobStore,
        bus: EventBus,
        stars: StarTable,
        now: Now,
        instruments: Registry,
    ) -> None:
        self._instruments = instruments
        self._flash = flash
        self._database, self._blobs, self._bus = database, blobs, bus
        self._stars, self._now = stars, now
        self._decoded: dict[str, OnboardCatalogue] = {}

    def lacks(self, report: BankReport) -> bool:
        """True if this bank is active and the ground does not have its content."""
        if report.kind != CATALOGUE or not report.active or not report.sha256:
            return False
        with self._database.unit_of_work() as session:
            return store.by_sha256(session, report.sha256) is None

    def views(self) -> list[BankView]:
        """Return every bank that the device reported."""
        reports = self._flash.of(CATALOGUES)
        with self._database.unit_of_work() as session:
            catalogues = [store.by_sha256(session, r.sha256) if r.sha256 else None for r in reports]
        return [_view(report, row) for report, row in zip(reports, catalogues, strict=True)]

    def hip_of_row(self, sha256: str) -> Sequence[int] | None:
        """Return the Hipparcos number of each row of the bank with that hash; None if the ground does not have it."""
        catalogue = self.onboard(sha256)
        return None if catalogue is None else [int(hip) for hip in catalogue.hip]

    def onboard(self, sha256: str) -> OnboardCatalogue | None:
        """Return the decoded bank with that hash; None if the ground does not have it."""
        if not sha256:
            return None
        if sha256 not in self._decoded:
            with self._database.unit_of_work() as session:
                row = store.by_sha256(session, sha256)
            if row is None:
                return None
            hips = np.array(row.manifest["hip"], np.int32)
            self._decoded[sha256] = decode(self._blobs.get(row.sha256), hips)
        return self._decoded[sha256]

    def adopt(self, image: bytes) -> Catalogue | None:
        """Store a bank image that was read back from the device, and identify its stars by position. Return None if the
        image is not a catalogue."""
        try:
            header = read_header(image)
            bank = decode(image)
        except GssError as error:
            self._bus.record("catalogue", "warning", f"The content read back from a bank is not a catalogue: {error}")
            return None
        hips = recognise(bank, self._stars)
        sha256 = self._blobs.put(image)
        row = Catalogue(
            name=f"{header.profile_name}-read-back",
            profile=header.profile_name,
            format=header.format_name,
            created=self._now(),
            author="read back from the device",
            stars=len(bank),
            pairs=len(bank.distances),
            size=len(image),
            sha256=sha256,
            valid_from=None,
            valid_to=None,
            request={},
            manifest={"hip": hips, "epoch_jyear": header.epoch_jyear, "source": "read back from the device"},
            report={},
            instrument_version=self._instruments.version_of(header.profile_name),
        )
        with self._database.unit_of_work() as session:
            store.add(session, row)
        unknown = hips.count(UNKNOWN_HIP)
        text = f"Bank content read back: {len(bank)} stars, {unknown} of them not in the ground's catalogue"
        self._bus.record("catalogue", "watch" if unknown else "ok", text, catalogue_id=row.id)
        return row


def recognise(bank: OnboardCatalogue, stars: StarTable) -> list[int]:
    """Return the Hipparcos number of each row: the brightest star within 5′ that is not assigned to another row. The
    distance of 5′ is the proper motion of α Centauri in 60 years. Rows are assigned in order of brightness, which
    matters for close pairs. If the format contains no magnitudes, the row order is used, because rows are sorted by
    brightness."""
    tree = cKDTree(stars.icrs)
    chord = 2 * np.sin(SAME_STAR_WITHIN_RAD / 2)
    near_rows = tree.query_ball_point(np.asarray(bank.icrs, float), chord)
    hips, used_stars = [UNKNOWN_HIP] * len(bank), set[int]()
    for row in np.argsort(np.nan_to_num(bank.v_mag, nan=0.0), kind="stable"):
        candidates = [k for k in near_rows[row] if k not in used_stars]
        if candidates:
            k = min(candidates, key=lambda k: stars.v_mag[k])
            used_stars.add(k)
            hips[row] = int(stars.hip[k])
    return hips


def days_left(valid_to: datetime | None, now: datetime) -> float | None:
    """Return the days until a catalogue expires; negative if it has expired, None if it never expires."""
    return None if valid_to is None else (valid_to - now).total_seconds() / 86400


def _view(report: BankReport, catalogue: Catalogue | None) -> BankView:
    stars, pairs = (int(report.values[n]) if report.holds_data else None for n in ("stars", "pairs"))
    sha256 = report.sha256 if report.holds_data else None
    return BankView(report.bank, report.state, report.active, stars, pairs, sha256, catalogue)

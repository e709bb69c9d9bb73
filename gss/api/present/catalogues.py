"""Built catalogues, their differences and the bank timeline as responses."""

from __future__ import annotations

from collections.abc import Sequence
from datetime import datetime

import numpy as np

from gss.api.schemas.catalogue_history import (
    BankPlanOut,
    BankStayOut,
    CatalogueDiffOut,
    CatalogueRefOut,
    ChangedStarOut,
    ContactSpanOut,
    CoverageOut,
    CoverOut,
    DeviceRefOut,
    TimelineOut,
)
from gss.api.schemas.catalogues import CatalogueDetailOut, CatalogueOut
from gss.domain.angles import ARCSEC_RAD, ra_dec_from_unit
from gss.domain.stars import Ids, StarTable
from gss.operations.catalogues.build_catalogue import StoredDiff
from gss.operations.catalogues.catalogue_report import MapStar, stored_report
from gss.operations.transfers.bank_history import BankPeriod, Timeline
from gss.operations.transfers.bank_plans import cover
from gss.operations.transfers.banks import BankView, days_left
from gss.skytables.bank import OnboardCatalogue
from gss.store.models import Catalogue

MAX_LISTED = 500
NEEDED_STARS = 3


def catalogue(row: Catalogue, banks: Sequence[BankView]) -> CatalogueOut:
    """Return a catalogue as a list entry."""
    names = "id name profile format created author stars pairs sha256 valid_from valid_to validity_known"
    return CatalogueOut(
        **{name: getattr(row, name) for name in names.split()},
        bytes=row.size,
        banks=[b.bank for b in banks if b.sha256 == row.sha256],
    )


def catalogue_detail(
    row: Catalogue, banks: Sequence[BankView], image: OnboardCatalogue | None, stars: StarTable
) -> CatalogueDetailOut:
    """Return a catalogue with maps and quality. Older catalogues have only some of them. A catalogue read back from the
    device has only the map of the stars in its ``image``. ``stars``: source of magnitudes for formats that store no
    magnitudes."""
    report = stored_report(row.report)
    if image is not None:
        report.sky = map_stars(image, stars)
    return CatalogueDetailOut(
        **dict(catalogue(row, banks)),
        **dict(report),
        instrument_version=row.instrument_version,
        request=row.request,
        manifest=row.manifest,
        no_magnitude=0 if image is None else len(image) - len(report.sky),
        reduced_stars=(row.manifest.get("counts") or {}).get("reduced catalogue"),
    )


def map_stars(image: OnboardCatalogue, stars: StarTable) -> list[MapStar]:
    """Return the stars of a bank image for the sky map, with state 'kept'. Stars without a magnitude are omitted."""
    ra, dec = (np.degrees(a) for a in ra_dec_from_unit(image.icrs.astype(float)))
    mags = [_magnitude(image, row, stars) for row in range(len(image))]
    return [
        {
            "hip": int(image.hip[row]),
            "ra_deg": round(float(ra[row]), 4),
            "dec_deg": round(float(dec[row]), 4),
            "v_mag": round(mag, 2),
            "state": "kept",
        }
        for row, mag in enumerate(mags)
        if mag is not None
    ]


def _magnitude(image: OnboardCatalogue, row: int, stars: StarTable) -> float | None:
    """Return the magnitude of a row from its bank or from the ground's catalogue; None if neither has one."""
    ground = stars.row_of_hip.get(int(image.hip[row]))
    mag = float(image.v_mag[row])
    if np.isfinite(mag):
        return mag
    return None if ground is None else float(stars.v_mag[ground])


def diff(stored_diff: StoredDiff, stars: StarTable) -> CatalogueDiffOut:
    """Return the changes on board if the new catalogue replaced the old. ``stars``: source of names, and of magnitudes
    for formats that store no magnitudes."""
    difference, coverage = stored_diff.diff, stored_diff.coverage
    moved = dict(zip(difference.moved.tolist(), (difference.moved_rad / ARCSEC_RAD).tolist(), strict=True))
    changed = dict(zip(difference.magnitude_changed.tolist(), difference.magnitude_change_mag.tolist(), strict=True))
    return CatalogueDiffOut(
        old=_reference(stored_diff.old),
        new=_reference(stored_diff.new),
        same_camera=stored_diff.same_camera,
        nothing=difference.nothing and stored_diff.old.sha256 == stored_diff.new.sha256,
        added_count=len(difference.added),
        dropped_count=len(difference.dropped),
        moved_count=len(difference.moved),
        magnitude_count=len(difference.magnitude_changed),
        same_count=len(difference.same),
        unknown_old=difference.unknown[0],
        unknown_new=difference.unknown[1],
        added=_stars(difference.added, stored_diff.after, stars),
        dropped=_stars(difference.dropped, stored_diff.before, stars),
        moved=_stars(difference.moved, stored_diff.after, stars, moved_arcsec=moved),
        magnitude=_stars(difference.magnitude_changed, stored_diff.after, stars, change_mag=changed),
        coverage=CoverageOut(
            nside=coverage.nside,
            radius_deg=float(np.degrees(coverage.radius_rad)),
            old=coverage.old.tolist(),
            new=coverage.new.tolist(),
            poorer=coverage.poorer(NEEDED_STARS),
        ),
    )


def _reference(row: Catalogue) -> CatalogueRefOut:
    names = "id name profile format sha256 stars pairs"
    values = {name: getattr(row, name) for name in names.split()}
    return CatalogueRefOut(**values, bytes=row.size, epoch_jyear=row.manifest.get("epoch_jyear"))


def _stars(
    hips: Ids, onboard: OnboardCatalogue, star_table: StarTable, **extra_columns: dict[int, float]
) -> list[ChangedStarOut]:
    row_of = {int(hip): row for row, hip in enumerate(onboard.hip)}
    ra, dec = (np.degrees(a) for a in ra_dec_from_unit(onboard.icrs.astype(float)))
    stars = []
    for hip in map(int, hips):
        row = row_of[hip]
        mag = _magnitude(onboard, row, star_table)
        extra_values = {name: values[hip] for name, values in extra_columns.items()}
        position = {"ra_deg": round(float(ra[row]), 4), "dec_deg": round(float(dec[row]), 4)}
        mag_or_none = None if mag is None else round(mag, 2)
        stars.append(
            ChangedStarOut(hip=hip, name=star_table.name_of(hip), v_mag=mag_or_none, **position, **extra_values)
        )
    return sorted(stars, key=lambda s: (s.v_mag is None, s.v_mag))[:MAX_LISTED]


def timeline(bank_timeline: Timeline, now: datetime, watch_days: float) -> TimelineOut:
    """Return the bank timeline of a device."""
    coverage_state = cover(bank_timeline.stays, bank_timeline.planned, now, watch_days)
    devices = [DeviceRefOut.model_validate(d) for d in bank_timeline.devices]
    return TimelineOut(
        device=DeviceRefOut.model_validate(bank_timeline.device),
        devices=devices,
        now=now,
        start=bank_timeline.start,
        end=bank_timeline.end,
        stays=[_stay(stay, now) for stay in bank_timeline.stays],
        planned=[BankPlanOut(**{n: getattr(p, n) for n in BankPlanOut.model_fields}) for p in bank_timeline.planned],
        contacts=[ContactSpanOut.model_validate(c) for c in bank_timeline.contacts],
        cover=CoverOut(state=coverage_state.state.value, text=coverage_state.text, until=coverage_state.until),
    )


def _stay(stay: BankPeriod, now: datetime) -> BankStayOut:
    row, catalogue = stay.row, stay.catalogue
    names = "bank state sha256 began ended reported how user"
    return BankStayOut(
        **{name: getattr(row, name) for name in names.split()},
        name=catalogue.name if catalogue else row.name,
        catalogue_id=catalogue.id if catalogue else row.catalogue_id,
        stars=catalogue.stars if catalogue else None,
        valid_from=catalogue.valid_from if catalogue else None,
        valid_to=catalogue.valid_to if catalogue else None,
        days_left=days_left(catalogue.valid_to, now) if catalogue else None,
    )

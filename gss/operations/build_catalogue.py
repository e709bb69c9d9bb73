"""The catalogue manager's work: preview, build as a job, keep, upload to a bank."""

from __future__ import annotations

import json
import time
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from gss.catalogue_tools.build import BuiltCatalogue, EnvelopeMap, Preview, build, preview
from gss.catalogue_tools.onboard import HEADER_VERSION, read_header
from gss.catalogue_tools.quality import Quality
from gss.catalogue_tools.request import BuildRequest
from gss.catalogue_tools.selection import Fate, Selection
from gss.device.dictionary import Dictionary
from gss.device.session import Compatibility
from gss.device.session_events import HelloReceived
from gss.domain.angles import ra_dec_from_unit
from gss.domain.errors import BadInput, Conflict
from gss.domain.stars import StarTable
from gss.operations.banks import BankService
from gss.operations.clock import Now
from gss.operations.jobs import JobService, Progress
from gss.operations.link import LinkService
from gss.operations.transfer_rows import TransferView
from gss.operations.transfers import TransferService
from gss.store import catalogues as store
from gss.store.blobs import BlobStore
from gss.store.engine import Database
from gss.store.models import Catalogue, Job

MOST_ON_MAP = 4000
STEPS = 100


@dataclass(frozen=True)
class TimedPreview:
    """A preview's report and how long it took."""

    stars: int
    pairs: int
    size: int
    report: dict[str, Any]
    elapsed_s: float


class CatalogueService:
    """Builds sub-catalogues and gives them to the device."""

    def __init__(
        self,
        database: Database,
        blobs: BlobStore,
        jobs: JobService,
        transfers: TransferService,
        banks: BankService,
        link: LinkService,
        stars: StarTable,
        now: Now,
    ) -> None:
        self._database, self._blobs, self._jobs = database, blobs, jobs
        self._transfers, self._banks, self._link = transfers, banks, link
        self._stars, self._now = stars, now

    def preview(self, request: BuildRequest) -> TimedPreview:
        """The quick look while parameters change."""
        start_s = time.perf_counter()
        quick: Preview = preview(request, self._stars)
        report = report_of(quick.selection, quick.map, None)
        return TimedPreview(len(quick.selection.kept), quick.pairs, quick.bytes, report, time.perf_counter() - start_s)

    def build(self, request: BuildRequest, asked: Mapping[str, Any], *, user: str) -> Job:
        """Build as a job; ``asked`` is the request as the builder's page gave it, kept to be opened again."""

        def work(progress: Progress) -> dict[str, Any]:
            built = build(request, self._stars, lambda stage, share: progress(round(share * STEPS), STEPS, stage))
            row = self._keep(built, asked, user)
            return {"catalogue_id": row.id}

        return self._jobs.submit("catalogue", f"build {request.name or 'catalogue'}", dict(asked), work)

    def _keep(self, built: BuiltCatalogue, asked: Mapping[str, Any], user: str) -> Catalogue:
        self._blobs.put(built.image)
        p = built.plan
        row = Catalogue(
            name=p.request.name or f"{p.profile.name}-{built.sha256[:6]}",
            profile=p.profile.name,
            format=p.request.format_name,
            created=self._now(),
            author=user,
            stars=len(built.stars),
            pairs=len(built.distances),
            size=len(built.image),
            sha256=built.sha256,
            valid_from=p.valid_from,
            valid_to=p.valid_to,
            request=dict(asked),
            manifest=json.loads(built.manifest.as_json()),
            report=report_of(built.selection, built.map, built.quality),
        )
        with self._database.unit_of_work() as session:
            return store.add(session, row)

    def newest(self, limit: int) -> list[Catalogue]:
        """Newest first."""
        with self._database.unit_of_work() as session:
            return store.newest(session, limit)

    def get(self, catalogue_id: int) -> Catalogue:
        """The catalogue of that id."""
        with self._database.unit_of_work() as session:
            return store.get(session, catalogue_id)

    def image(self, catalogue_id: int) -> bytes:
        """The bytes for the bank."""
        return self._blobs.get(self.get(catalogue_id).sha256)

    def upload(self, catalogue_id: int, bank: str) -> TransferView:
        """Send a catalogue to an inactive bank; read-back verify and commit follow by themselves."""
        row, hello = self.get(catalogue_id), self._link.hello
        if hello is None:
            raise Conflict("no device has answered", got=self._link.reason or "silence", hint="open the line first")
        target = bank_number(self._link.dictionary, bank)
        if any(view.bank == bank and view.active for view in self._banks.views()):
            raise Conflict(
                f"bank {bank} is active", expected="an inactive bank", got=bank, hint="the sensor matches from it now"
            )
        image = self._blobs.get(row.sha256)
        compatibility = compatibility_of(image, hello)
        return self._transfers.upload(
            "catalogue",
            target,
            image,
            compatibility,
            name=bank,
            subject=f"{row.name} to bank {bank}",
            catalogue_id=row.id,
        )


def compatibility_of(image: bytes, hello: HelloReceived) -> Compatibility:
    """What the device checks before it takes a bank image; BadInput when it is for another camera or does not fit."""
    header = read_header(image)
    if header.profile_name != hello.profile:
        raise BadInput("this catalogue is for another camera", expected=hello.profile, got=header.profile_name)
    if len(image) > hello.bank_bytes:
        raise BadInput(
            "the catalogue does not fit the bank",
            expected=f"at most {hello.bank_bytes} bytes",
            got=f"{len(image)} bytes",
        )
    return Compatibility(
        device_model=hello.device_model,
        profile=header.profile_name,
        dictionary_hash=bytes.fromhex(hello.dictionary_hash),
        format_version=HEADER_VERSION,
        epoch_jyear=header.epoch_jyear,
        stars=header.stars,
        pairs=header.pairs,
    )


def bank_number(dictionary: Dictionary, bank: str) -> int:
    """The number of a bank on the wire; BadInput lists the banks."""
    return dictionary.command("VERIFY_BANK").argument("bank").choice(bank).value


def report_of(selection: Selection, envelope: EnvelopeMap, quality: Quality | None) -> dict[str, Any]:
    """Funnel, map and quality as plain values; angles in degrees, for they only travel to the page."""
    report: dict[str, Any] = {
        "funnel": [
            {"label": f.label, "stars": f.stars, "kind": "drop" if f.dropped else "keep"} for f in selection.funnel
        ],
        "sky": _sky(selection),
        "envelope": {
            "nside": envelope.nside,
            "fraction": [round(float(x), 4) for x in envelope.fraction],
            "outline_start": [_line(edge) for edge in envelope.edges_start],
            "outline_end": [_line(edge) for edge in envelope.edges_end],
        },
    }
    if quality is not None:
        candidates = quality.candidates_per_query
        report["quality"] = {
            "pointings": quality.pointings,
            "histogram": [int(n) for n in quality.histogram],
            "mean": quality.mean,
            "p_fewer_than_3": quality.p_fewer_than(3),
            "p_fewer_than_5": quality.p_fewer_than(5),
            "worst_stars": quality.worst_stars,
            "worst_ra_deg": float(np.degrees(quality.worst_ra_rad)),
            "worst_dec_deg": float(np.degrees(quality.worst_dec_rad)),
            "candidates_per_query": float(candidates) if np.isfinite(candidates) else None,
        }
    return report


def _sky(selection: Selection) -> list[dict[str, Any]]:
    stars = selection.candidates
    ra, dec = (np.degrees(a) for a in ra_dec_from_unit(stars.icrs))
    return [
        {
            "hip": int(stars.hip[k]),
            "ra_deg": round(float(ra[k]), 4),
            "dec_deg": round(float(dec[k]), 4),
            "v_mag": round(float(stars.v_mag[k]), 2),
            "state": Fate(int(selection.fate[k])).map_state,
        }
        for k in range(min(len(stars), MOST_ON_MAP))
    ]


def _line(edge: Any) -> list[tuple[float, float]]:
    ra, dec = (np.degrees(a) for a in ra_dec_from_unit(np.asarray(edge)))
    return [
        (round(float(a), 3), round(float(d), 3)) for a, d in zip(np.atleast_1d(ra), np.atleast_1d(dec), strict=True)
    ]

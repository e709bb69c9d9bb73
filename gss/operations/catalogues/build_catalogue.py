"""Catalogue management: preview, build as a job, store, compare, export, upload to a bank."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Any, Literal

import numpy as np

from gss.catalogue_tools.build import BuiltCatalogue, finish, prepare, preview, too_heavy
from gss.catalogue_tools.diff import CatalogueDiff, CoverageChange, compare, coverage_change
from gss.catalogue_tools.envelope.field import FieldShape
from gss.catalogue_tools.formats.registry import base_format
from gss.catalogue_tools.onboard import FORMATS, decode, read_header
from gss.catalogue_tools.plan import plan
from gss.catalogue_tools.request import BuildRequest
from gss.catalogue_tools.sources.sources import Source
from gss.device.dictionary import Dictionary
from gss.device.golden import matching_formats
from gss.device.session import Compatibility
from gss.device.session_events import HelloReceived
from gss.domain.errors import BadInput, Conflict
from gss.domain.profiles import profile
from gss.domain.stars import OnboardCatalogue, StarTable
from gss.operations.catalogues.catalogue_files import ExportFile, export_file
from gss.operations.catalogues.catalogue_report import preview_report, report_of
from gss.operations.catalogues.star_lists import StarListService
from gss.operations.clock import Now
from gss.operations.jobs import JobService, Keep, Resumable, Run
from gss.operations.line.link import LinkService
from gss.operations.transfers.banks import BankService
from gss.operations.transfers.transfer_rows import TransferView
from gss.operations.transfers.transfers import TransferService
from gss.store import catalogues as store
from gss.store.blobs import BlobStore
from gss.store.engine import Database
from gss.store.models import Catalogue, Job

STEPS = 100

BankSource = Literal["asked", "sensor", "usual"]
Words = Callable[[Mapping[str, Any], str, datetime], BuildRequest]
"""Converts (request as sent by the page, user, time of the request) to a build request."""


@dataclass(frozen=True)
class TimedPreview:
    """A preview's report and how long it took. ``bank_source``: where the bank size comes from: asked, sensor or usual."""

    stars: int
    pairs: int
    size: int
    bank_bytes: int
    report: dict[str, Any]
    elapsed_s: float
    bank_source: BankSource = "usual"


@dataclass(frozen=True)
class StoredDiff:
    """Differences between two stored catalogues. ``same_camera``: False if they are for different instruments."""

    old: Catalogue
    new: Catalogue
    before: OnboardCatalogue
    after: OnboardCatalogue
    diff: CatalogueDiff
    coverage: CoverageChange
    same_camera: bool


class CatalogueService:
    """Builds catalogues and uploads them to the device."""

    def __init__(
        self,
        database: Database,
        blobs: BlobStore,
        jobs: JobService,
        transfers: TransferService,
        banks: BankService,
        link: LinkService,
        lists: StarListService,
        stars: StarTable,
        now: Now,
    ) -> None:
        self._database, self._blobs, self._jobs = database, blobs, jobs
        self._transfers, self._banks, self._link, self._lists = transfers, banks, link, lists
        self._stars, self._now = stars, now
        self.words: Words | None = None
        """Parses a request as sent by the builder's page; set by the API."""
        jobs.resumable("catalogue", self._again)

    def preview(self, request: BuildRequest, *, mistakes: bool = False) -> TimedPreview:
        """Return a quick preview for interactive changes of parameters."""
        start_s = time.perf_counter()
        request, source = self._with_bank(request)
        quick = preview(request, self._source(request), mistakes=mistakes)
        report = preview_report(quick)
        elapsed_s = time.perf_counter() - start_s
        return TimedPreview(
            len(quick.selection.kept), quick.pairs, quick.bytes, quick.plan.bank_bytes, report, elapsed_s, source
        )

    def build(self, request: BuildRequest, asked: Mapping[str, Any], *, user: str) -> Job:
        """Build a catalogue as a job; ``asked`` is the request as sent by the builder's page, stored so that it can be
        reopened. An impossible request is rejected at once."""
        request, _ = self._with_bank(request)
        work = self._work(request, asked, user)
        kept = {"asked": dict(asked), "user": user, "at": self._now().isoformat(), "bank_bytes": request.bank_bytes}
        return self._jobs.begin("catalogue", f"build {request.name or 'catalogue'}", kept, work)

    def _again(self, run: Run) -> dict[str, Any]:
        asked, user = run.request["asked"], run.request["user"]
        if self.words is None:
            raise BadInput("nobody here reads the builder's words", hint="build it again on the Catalogues page")
        request = self.words(asked, user, datetime.fromisoformat(run.request["at"]))
        request = replace(request, bank_bytes=run.request.get("bank_bytes", request.bank_bytes))
        return self._work(request, asked, user)(run)

    def _work(self, request: BuildRequest, asked: Mapping[str, Any], user: str) -> Resumable:
        source = self._source(request)
        # Long preparations run inside the job, where they report progress and can be cancelled.
        ready = None if too_heavy(plan(request), source) else prepare(request, source)

        def work(run: Run) -> dict[str, Any]:
            if run.checkpoint:  # the row was stored before the server stopped
                return run.checkpoint

            def tell(stage: str, share: float) -> None:
                run.progress(round(share * STEPS), STEPS, stage)

            built = finish(prepare(request, source, tell) if ready is None else ready, tell)
            row = self._keep(built, asked, user, run.keep)
            return {"catalogue_id": row.id}

        return work

    def _with_bank(self, request: BuildRequest) -> tuple[BuildRequest, BankSource]:
        """Return the request with the bank size of the connected sensor if it has that camera, and the source of the bank
        size."""
        hello = self._link.hello
        if request.bank_bytes is not None:
            return request, "asked"
        if hello is None or hello.profile != request.profile_name:
            return request, "usual"
        return replace(request, bank_bytes=hello.bank_bytes), "sensor"

    def _source(self, request: BuildRequest) -> Source | StarTable:
        if request.source == "hipparcos":
            return self._stars
        return self._lists.source(request.source, request.star_list, request.depth_mag, request.profile_name)

    def _keep(self, built: BuiltCatalogue, asked: Mapping[str, Any], user: str, keep: Keep) -> Catalogue:
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
            report=report_of(built),
        )
        with self._database.unit_of_work() as session:
            store.add(session, row)
            keep({"catalogue_id": row.id}, session)
        return row

    def newest(self, limit: int) -> list[Catalogue]:
        """Return the newest catalogues first."""
        with self._database.unit_of_work() as session:
            return store.newest(session, limit)

    def get(self, catalogue_id: int) -> Catalogue:
        """Return the catalogue with that id. Raises NotFound."""
        with self._database.unit_of_work() as session:
            return store.get(session, catalogue_id)

    def image(self, catalogue_id: int) -> bytes:
        """Return the bank image."""
        return self._blobs.get(self.get(catalogue_id).sha256)

    def diff(self, old_id: int, new_id: int) -> StoredDiff:
        """Return the differences between two catalogues; coverage is computed for circles as large as the new catalogue's
        field of view."""
        old, new = self.get(old_id), self.get(new_id)
        before, after = self._decoded(old), self._decoded(new)
        radius_rad = FieldShape(profile(new.profile).camera).equal_circle_rad
        coverage = coverage_change(before, after, radius_rad)
        return StoredDiff(old, new, before, after, compare(before, after), coverage, old.profile == new.profile)

    def export(self, catalogue_id: int, kind: str) -> ExportFile:
        """Return a stored catalogue in another file format."""
        row = self.get(catalogue_id)
        return export_file(self._blobs.get(row.sha256), row.manifest, kind, row.name)

    def _decoded(self, row: Catalogue) -> OnboardCatalogue:
        return decode(self._blobs.get(row.sha256), np.array(row.manifest["hip"], np.int32))

    def upload(self, catalogue_id: int, bank: str) -> TransferView:
        """Upload a catalogue to an inactive bank; read-back verification and commit follow automatically. Raises Conflict or
        BadInput."""
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
        check_matching(row.format, hello.profile)
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
    """Return what the device checks before it accepts a bank image. Raises BadInput if the image is for another camera or
    too large."""
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
        format_version=FORMATS[header.format_name],
        epoch_jyear=header.epoch_jyear,
        stars=header.stars,
        pairs=header.pairs,
    )


def check_matching(format_name: str, profile_name: str) -> None:
    """Raise Conflict for a catalogue that the unit would accept but could not match from."""
    matched = matching_formats(profile_name)
    if base_format(format_name) not in matched:
        raise Conflict(
            "the sensor cannot match from this catalogue: it needs what the format lacks",
            expected=" | ".join(matched),
            got=format_name,
            hint="build it again in the camera's own format; the activation of this one would be refused",
        )


def bank_number(dictionary: Dictionary, bank: str) -> int:
    """Return the number of a bank in the protocol. Raises BadInput with the list of banks."""
    return dictionary.command("VERIFY_BANK").argument("bank").choice(bank).value

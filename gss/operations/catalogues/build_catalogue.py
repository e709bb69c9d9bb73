"""Catalogue service: preview, build as a job, store, compare, export, and upload to a bank."""

from __future__ import annotations

import json
import time
from dataclasses import dataclass, replace
from datetime import datetime
from typing import Literal

import numpy as np

from gss.catalogue_tools.build import BuiltCatalogue, finish, prepare, preview, too_heavy
from gss.catalogue_tools.diff import CatalogueDiff, CoverageChange, compare, coverage_change
from gss.catalogue_tools.envelope.field import FieldShape
from gss.catalogue_tools.formats.registry import base_format
from gss.catalogue_tools.onboard import FORMATS, decode, read_header
from gss.catalogue_tools.plan import plan
from gss.catalogue_tools.request import BuildRequest
from gss.catalogue_tools.sources.sources import StarSource
from gss.device.protocol.transfer import Compatibility
from gss.device.session_events import HelloReceived
from gss.domain.camera_profile import CameraProfile
from gss.domain.errors import BadInput, Conflict
from gss.domain.stars import StarTable
from gss.instruments.registry import Registry
from gss.operations.catalogues.catalogue_files import ExportFile, export_file
from gss.operations.catalogues.catalogue_report import PreviewReport, preview_report, report_of
from gss.operations.catalogues.catalogue_request import CatalogueRequest, build_request, with_camera
from gss.operations.catalogues.star_lists import StarListService
from gss.operations.clock import Now
from gss.operations.jobs import JobKind, JobRequest, JobResult, JobRun, JobService, Keep, Work
from gss.operations.line.link import LinkService
from gss.operations.requests import as_stored
from gss.operations.transfers.flash_banks import CATALOGUE, FlashBanks
from gss.operations.transfers.transfer_progress import TransferView
from gss.operations.transfers.transfers import TransferService
from gss.skytables.bank import OnboardCatalogue
from gss.store import catalogues as store
from gss.store.blobs import BlobStore
from gss.store.engine import Database
from gss.store.models import Catalogue, Job

STEPS = 100

BankSource = Literal["asked", "sensor", "usual"]


@dataclass(frozen=True)
class BuildJob(JobRequest):
    """Job that builds a catalogue. ``at``: time of the request; the period of use begins at this time if the request
    has no start. ``bank_bytes``: size of the bank at that time."""

    asked: CatalogueRequest
    at: datetime
    bank_bytes: int | None = None


@dataclass(frozen=True)
class TimedPreview:
    """Report of a preview and its duration. ``bank_source``: source of the bank size: the request, the connected sensor, or the
    usual size."""

    stars: int
    pairs: int
    size: int
    bank_bytes: int
    report: PreviewReport
    elapsed_s: float
    bank_source: BankSource = "usual"


@dataclass(frozen=True)
class StoredDiff:
    """Differences between two stored catalogues. ``same_camera``: False if the catalogues are for different instruments."""

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
        flash: FlashBanks,
        link: LinkService,
        lists: StarListService,
        stars: StarTable,
        now: Now,
        instruments: Registry,
        unit: str,
    ) -> None:
        self._instruments, self._unit = instruments, unit
        self._database, self._blobs, self._jobs = database, blobs, jobs
        self._transfers, self._flash, self._link, self._lists = transfers, flash, link, lists
        self._stars, self._now = stars, now
        jobs.register(JobKind("catalogue", BuildJob, self._build))

    def preview(self, spec: CatalogueRequest, *, user: str, mistakes: bool = False) -> TimedPreview:
        """Return a quick preview for interactive changes of parameters."""
        start_s = time.perf_counter()
        request, source = self._with_bank(build_request(spec, self._camera(spec), user, self._now()))
        quick = preview(request, self._source(request), mistakes=mistakes)
        report = preview_report(quick)
        elapsed_s = time.perf_counter() - start_s
        return TimedPreview(
            len(quick.selection.kept), quick.pairs, quick.bytes, quick.plan.bank_bytes, report, elapsed_s, source
        )

    def build(self, spec: CatalogueRequest, *, user: str) -> Job:
        """Start a job that builds a catalogue. The request is stored with the catalogue, so a user can open and edit it again. An
        invalid request is rejected immediately."""
        at, camera = self._now(), self._camera(spec)
        spec = with_camera(spec, camera)
        request, _ = self._with_bank(build_request(spec, camera, user, at))
        job = BuildJob(spec, at, request.bank_bytes, user=user)
        return self._jobs.begin("catalogue", f"build {spec.name or 'catalogue'}", job, self._work(request, job))

    def _build(self, job: BuildJob, run: JobRun) -> JobResult:
        request = build_request(job.asked, self._camera(job.asked), job.user, job.at)
        return self._work(replace(request, bank_bytes=job.bank_bytes or request.bank_bytes), job)(run)

    def _camera(self, spec: CatalogueRequest) -> CameraProfile:
        return self._instruments.camera(spec.profile or self._unit)

    def _work(self, request: BuildRequest, job: BuildJob) -> Work:
        source = self._source(request)
        # Long preparations run inside the job, where they report progress and can be cancelled.
        ready = None if too_heavy(plan(request), source) else prepare(request, source)

        def work(run: JobRun) -> JobResult:
            if run.checkpoint:  # the row was stored before the server stopped
                return run.checkpoint

            def report(stage: str, share: float) -> None:
                run.progress(round(share * STEPS), STEPS, stage.capitalize())

            built = finish(prepare(request, source, report) if ready is None else ready, report)
            row = self._keep(built, job, run.keep)
            return {"catalogue_id": row.id}

        return work

    def _with_bank(self, request: BuildRequest) -> tuple[BuildRequest, BankSource]:
        """Return the request with a bank size, and the source of this size. The size is that of the connected sensor if
        the sensor has the requested camera, otherwise that of the instrument's package."""
        hello = self._link.hello
        if request.bank_bytes is not None:
            return request, "asked"
        if hello is not None and hello.profile == request.profile_name:
            return replace(request, bank_bytes=hello.bank_bytes), "sensor"
        return replace(request, bank_bytes=self._instruments.bank_bytes(request.profile_name)), "usual"

    def _source(self, request: BuildRequest) -> StarSource | StarTable:
        if request.source == "hipparcos":
            return self._stars
        return self._lists.source(request.source, request.star_list, request.depth_mag, request.profile_name)

    def _keep(self, built: BuiltCatalogue, job: BuildJob, keep: Keep) -> Catalogue:
        self._blobs.put(built.image)
        plan = built.plan
        row = Catalogue(
            name=plan.request.name or f"{plan.profile.name}-{built.sha256[:6]}",
            profile=plan.profile.name,
            format=plan.request.format_name,
            created=self._now(),
            author=job.user,
            stars=len(built.stars),
            pairs=len(built.distances),
            size=len(built.image),
            sha256=built.sha256,
            valid_from=plan.valid_from,
            valid_to=plan.valid_to,
            request=as_stored(job.asked),
            manifest=json.loads(built.manifest.as_json()),
            report=report_of(built),
            instrument_version=self._instruments.version_of(plan.profile.name),
        )
        with self._database.unit_of_work() as session:
            store.add(session, row)
            keep({"catalogue_id": row.id}, session)
        return row

    def newest(self, limit: int) -> list[Catalogue]:
        """Return the latest catalogues, newest first."""
        with self._database.unit_of_work() as session:
            return store.newest(session, limit)

    def get(self, catalogue_id: int) -> Catalogue:
        """Return the catalogue with that id. Raises NotFound."""
        with self._database.unit_of_work() as session:
            return store.get(session, catalogue_id)

    def image(self, catalogue_id: int) -> bytes:
        """Return the bank image of a catalogue. Raises NotFound."""
        return self._blobs.get(self.get(catalogue_id).sha256)

    def diff(self, old_id: int, new_id: int) -> StoredDiff:
        """Return the differences between two catalogues. Coverage is computed for circles with the same area as the field of
        view of the new catalogue's camera."""
        old, new = self.get(old_id), self.get(new_id)
        before, after = self._decoded(old), self._decoded(new)
        radius_rad = FieldShape(self._instruments.camera(new.profile).camera).equal_circle_rad
        coverage = coverage_change(before, after, radius_rad)
        return StoredDiff(old, new, before, after, compare(before, after), coverage, old.profile == new.profile)

    def export(self, catalogue_id: int, kind: str) -> ExportFile:
        """Return a stored catalogue in another file format."""
        row = self.get(catalogue_id)
        return export_file(self._blobs.get(row.sha256), row.manifest, kind, row.name)

    def _decoded(self, row: Catalogue) -> OnboardCatalogue:
        return decode(self._blobs.get(row.sha256), np.array(row.manifest["hip"], np.int32))

    def upload(self, catalogue_id: int, bank: str) -> TransferView:
        """Start the upload of a catalogue to an inactive bank. Verification and commit follow automatically. Raises Conflict or
        BadInput."""
        row = self.get(catalogue_id)
        target, hello = self._flash.target(CATALOGUE, bank)
        image = self._blobs.get(row.sha256)
        compatibility = compatibility_of(image, hello)
        check_matching(row.format, self._instruments.camera(hello.profile))
        return self._transfers.upload(
            CATALOGUE,
            target,
            image,
            compatibility,
            name=bank,
            subject=f"{row.name} to bank {bank}",
            catalogue_id=row.id,
        )


def compatibility_of(image: bytes, hello: HelloReceived) -> Compatibility:
    """Return the values that the device checks before it accepts a bank image. Raises BadInput if the image is for another
    camera or too large."""
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


def check_matching(format_name: str, camera: CameraProfile) -> None:
    """Raise Conflict if a unit with this camera would accept the format but could not use it for matching."""
    matched = camera.matching_formats
    if base_format(format_name) not in matched:
        raise Conflict(
            "the sensor cannot match with this catalogue, because its format does not contain all required data",
            expected=" | ".join(matched),
            got=format_name,
            hint="rebuild it in the camera's own format; the sensor would reject the activation of this catalogue",
        )

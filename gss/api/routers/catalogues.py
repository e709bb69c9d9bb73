"""Sub-catalogues: preview, build, compare, export and upload, and the bank timeline."""

from __future__ import annotations

import json
from datetime import timedelta
from typing import Annotated, Literal

from fastapi import Form, Query, Response, UploadFile
from fastapi.responses import HTMLResponse
from pydantic import ValidationError

from gss.api import present
from gss.api.api_router import api_router
from gss.api.deps import EXPORT, App, AuditNote, QueryTime, RowId, User, need
from gss.api.guard.bodies import MAX_BODY_BYTES
from gss.api.present.catalogue_sheet import catalogue_sheet
from gss.api.schemas.base import MAX_ID
from gss.api.schemas.catalogue_history import CatalogueDiffOut, StarListOut, TimelineOut
from gss.api.schemas.catalogues import (
    CatalogueDetailOut,
    CatalogueOrbitOut,
    CatalogueOut,
    ListMappingIn,
    PreviewOut,
    UploadIn,
)
from gss.api.schemas.jobs import JobOut
from gss.api.schemas.transfers import TransferOut
from gss.catalogue_tools.sources.star_list_mapping import ListMapping
from gss.domain.errors import BadInput
from gss.operations.catalogues.catalogue_request import CatalogueRequest
from gss.operations.passes.catalogue_orbit import catalogue_orbit
from gss.operations.report.html import as_html
from gss.operations.report.parts import Report
from gss.operations.report.pdf import as_pdf
from gss.store.models import Catalogue

router = api_router("catalogues", "/catalogues")
PAST, FUTURE = timedelta(days=60), timedelta(days=60)
Kind = Literal[
    "image",
    "manifest",
    "c",
    "csv",
    "ecsv",
    "fits",
    "parquet",
    "tables-fits",
    "tables-csv",
    "tables-ecsv",
    "tables-parquet",
]
Id = Annotated[int, Query(ge=1, le=MAX_ID)]


@router.get("")
def list_catalogues(app: App, limit: Annotated[int, Query(ge=1, le=500)] = 50) -> list[CatalogueOut]:
    """Catalogues, newest first."""
    banks = app.transfers.banks.views()
    return [present.catalogues.catalogue(row, banks) for row in app.catalogues.catalogues.newest(limit)]


@router.post("/preview", dependencies=[need("catalogues.build", changes=False)])
def preview(app: App, user: User, body: CatalogueRequest, ambiguity: bool = False) -> PreviewOut:
    """Preview a build while parameters change. ``ambiguity`` adds a coarse sky map of possible misidentifications."""
    quick = app.catalogues.catalogues.preview(body, user=user, mistakes=ambiguity)
    sizes = {"pairs_estimate": quick.pairs, "bytes_estimate": quick.size, "bank_bytes": quick.bank_bytes}
    figures = {"stars": quick.stars, "bank_source": quick.bank_source, "elapsed_ms": 1000 * quick.elapsed_s}
    return PreviewOut.model_validate({**quick.report, **sizes, **figures})


@router.post("", status_code=202, dependencies=[need("catalogues.build")])
def build_catalogue(app: App, user: User, body: CatalogueRequest) -> JobOut:
    """Build a catalogue as a job; its result names the catalogue."""
    return present.records.job(app.catalogues.catalogues.build(body, user=user))


@router.get("/diff")
def diff(app: App, old: Id, new: Id) -> CatalogueDiffOut:
    """Differences on board if one stored catalogue replaced another."""
    return present.catalogues.diff(app.catalogues.catalogues.diff(old, new), app.base.stars)


@router.get("/timeline")
def timeline(
    app: App,
    device: Annotated[int | None, Query(ge=1, le=MAX_ID)] = None,
    start: QueryTime | None = None,
    end: QueryTime | None = None,
) -> TimelineOut:
    """Past, current and planned catalogues in each bank of a device; by default of the device that responded most
    recently."""
    now = app.base.clock.now()
    history = app.transfers.bank_history.timeline(start or now - PAST, end or now + FUTURE, device)
    return present.catalogues.timeline(history, now, app.base.settings.catalogue_watch_days)


@router.get("/sources")
def list_sources(app: App, limit: Annotated[int, Query(ge=1, le=500)] = 50) -> list[StarListOut]:
    """Imported star lists, newest first."""
    return [StarListOut.model_validate(row) for row in app.catalogues.star_lists.newest(limit)]


@router.post("/sources", status_code=201, dependencies=[need("catalogues.build")])
def add_source(
    app: App,
    user: User,
    file: UploadFile,
    name: Annotated[str, Form(max_length=80)] = "",
    profile: Annotated[str, Form(max_length=40)] = "",
    mapping: Annotated[str, Form(max_length=4000)] = "{}",
) -> StarListOut:
    """Import a CSV, ECSV, FITS or VOTable list as a star source. ``mapping``: JSON with columns, units, epoch_jyear,
    frame, bad_rows (drop or refuse). The response reports what was read and which rows were dropped."""
    data = file.file.read(MAX_BODY_BYTES + 1)
    row = app.catalogues.star_lists.add(
        data, file.filename or "", _mapping(mapping), user=user, profile=profile, name=name
    )
    return StarListOut.model_validate(row)


@router.get("/{catalogue_id}")
def read_catalogue(app: App, catalogue_id: RowId) -> CatalogueDetailOut:
    """Catalogue with its maps and quality."""
    row, banks = app.catalogues.catalogues.get(catalogue_id), app.transfers.banks
    image = None if row.report else banks.onboard(row.sha256)
    return present.catalogues.catalogue_detail(row, banks.views(), image, app.base.stars)


@router.get("/{catalogue_id}/orbit")
def compare_with_orbit(app: App, catalogue_id: RowId) -> CatalogueOrbitOut:
    """Whether the imported orbit is inside the envelope of the catalogue, and until when."""
    return CatalogueOrbitOut.model_validate(
        catalogue_orbit(
            app.catalogues.catalogues.get(catalogue_id),
            app.passes.spacecraft.current(),
            app.base.clock.now(),
            timedelta(days=app.base.settings.catalogue_watch_days),
        )
    )


@router.get("/{catalogue_id}/report.html", response_class=HTMLResponse, dependencies=[EXPORT])
def report_page(app: App, catalogue_id: RowId) -> HTMLResponse:
    """Quality report as one self-contained HTML page without scripts."""
    return HTMLResponse(as_html(_sheet(app.catalogues.catalogues.get(catalogue_id))))


@router.get("/{catalogue_id}/report.pdf", response_class=Response, dependencies=[EXPORT])
def report_pdf(app: App, catalogue_id: RowId) -> Response:
    """Quality report as a PDF file."""
    row = app.catalogues.catalogues.get(catalogue_id)
    headers = {"Content-Disposition": f"attachment; filename=catalogue-{catalogue_id}.pdf"}
    return Response(as_pdf(_sheet(row), row.created), media_type="application/pdf", headers=headers)


def _sheet(row: Catalogue) -> Report:
    row_values = {"name": row.name, "author": row.author, "image_sha256": row.sha256, "profile_name": row.profile}
    return catalogue_sheet({**row_values, **row.manifest, "name": row.name}, row.report)


@router.get("/{catalogue_id}/export", response_class=Response, dependencies=[EXPORT])
def export(app: App, catalogue_id: RowId, kind: Kind) -> Response:
    """Export a catalogue: bank image, manifest, C source, star list, or all tables."""
    exported = app.catalogues.catalogues.export(catalogue_id, kind)
    headers = {"Content-Disposition": f'attachment; filename="{exported.name}"'}
    return Response(exported.content, media_type=exported.media_type, headers=headers)


@router.get("/{catalogue_id}/image.bin", response_class=Response, dependencies=[EXPORT])
def image(app: App, catalogue_id: RowId) -> Response:
    """Bank image of a catalogue."""
    headers = {"Content-Disposition": f"attachment; filename=catalogue-{catalogue_id}.bin"}
    return Response(
        app.catalogues.catalogues.image(catalogue_id), media_type="application/octet-stream", headers=headers
    )


@router.get("/{catalogue_id}/manifest.json", response_class=Response, dependencies=[EXPORT])
def manifest(app: App, catalogue_id: RowId) -> Response:
    """Manifest of a catalogue: its content and origin."""
    text = json.dumps(app.catalogues.catalogues.get(catalogue_id).manifest, indent=1)
    headers = {"Content-Disposition": f"attachment; filename=catalogue-{catalogue_id}.json"}
    return Response(text, media_type="application/json", headers=headers)


@router.post("/{catalogue_id}/upload", status_code=201, dependencies=[need("catalogues.upload")])
def upload(app: App, catalogue_id: RowId, body: UploadIn, user: User, audit_note: AuditNote) -> TransferOut:
    """Send a catalogue to an inactive bank."""
    previous = next(
        (v.catalogue.name for v in app.transfers.banks.views() if v.bank == body.bank and v.catalogue), "unknown"
    )
    audit_note(f"{app.catalogues.catalogues.get(catalogue_id).name} to bank {body.bank}, before {previous}")
    app.commanding.authority.check(user)
    return present.records.transfer(app.catalogues.catalogues.upload(catalogue_id, body.bank))


def _mapping(text: str) -> ListMapping:
    try:
        return ListMapping(**ListMappingIn.model_validate_json(text or "{}").model_dump())
    except ValidationError as error:
        first = error.errors(include_url=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        raise BadInput(
            "invalid column mapping",
            expected='JSON, for example {"columns": {"ra": "RAJ2000"}, "epoch_jyear": 2000.0}',
            got=f"{where}: {first['msg']}".removeprefix(": ")[:200],
        ) from None

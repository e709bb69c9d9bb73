"""Instrument packages: list, show, check, install, export and compare."""

from __future__ import annotations

from typing import Annotated

from fastapi import Path, Query, Response, UploadFile
from fastapi.responses import HTMLResponse

from gss.api import present
from gss.api.api_router import api_router
from gss.api.deps import EXPORT, App, AuditNote, User, need
from gss.api.present.help_page import single_page
from gss.api.schemas.instruments import (
    FileDifferenceOut,
    InstrumentDetailOut,
    InstrumentOut,
    InstrumentsOut,
    PackageCheckOut,
)
from gss.api.schemas.jobs import JobOut
from gss.domain.errors import NotFound
from gss.instruments.package_source import MAX_ZIP_BYTES
from gss.operations.studies.new_instrument_requests import PhotographsRequest

router = api_router("instruments", "/instruments")
Name = Annotated[str, Path(max_length=40)]
Version = Annotated[str, Query(max_length=64, pattern="^[0-9a-f]*$")]
Reference = Annotated[str, Query(max_length=120)]


@router.get("")
def list_instruments(app: App) -> InstrumentsOut:
    """Installed instruments, shipped ones first, and packages that cannot be loaded."""
    return present.instruments.instruments(app.instruments)


@router.get("/diff")
def diff_instruments(app: App, old: Reference, new: Reference) -> list[FileDifferenceOut]:
    """Differences between the files of two packages, each given as NAME or NAME@VERSION."""
    return [FileDifferenceOut.model_validate(d) for d in app.instruments.compare(old, new)]


@router.post("/check", dependencies=[need("instruments", changes=False)])
def check_package(app: App, file: UploadFile) -> PackageCheckOut:
    """Check a zipped package without installing it."""
    return present.instruments.package_check(app.instruments.check(_read(file), file.filename or ""))


@router.post("", status_code=201, dependencies=[need("instruments")])
def add_instrument(app: App, user: User, file: UploadFile, audit_note: AuditNote) -> InstrumentOut:
    """Check a zipped package and install it. The replaced version is kept for comparison."""
    audit_note(f"package {file.filename or ''}")
    added = app.instruments.add(_read(file), file.filename or "", user=user)
    audit_note(f"{added.instrument.name} version {added.instrument.version}")
    return present.instruments.instrument(added)


@router.post("/photographs", status_code=202, dependencies=[need("instruments")])
def new_from_photographs(app: App, user: User, body: PhotographsRequest, audit_note: AuditNote) -> JobOut:
    """Create and install an instrument from stored photographs of the night sky, as a job. If no camera can be
    calibrated, the job fails with a reason for each photograph, and nothing is installed."""
    audit_note(f"{body.name} from {len(body.frame_ids)} photographs")
    return present.records.job(app.studies.new_instruments.start(body, user=user))


@router.get("/{name}")
def read_instrument(app: App, name: Name, version: Version = "") -> InstrumentDetailOut:
    """Content of a package, by default of the current version."""
    return present.instruments.instrument_detail(app.instruments.get(name, version), app.instruments.versions(name))


@router.get("/{name}/package.zip", response_class=Response, dependencies=[EXPORT])
def export_instrument(app: App, name: Name, version: Version = "") -> Response:
    """Package as a zip archive."""
    data = app.instruments.export(name, version)
    headers = {"Content-Disposition": f"attachment; filename={name}.zip"}
    return Response(data, media_type="application/zip", headers=headers)


@router.get("/{name}/procedures/{file}", response_class=HTMLResponse, dependencies=[EXPORT])
def read_procedure(app: App, name: Name, file: Annotated[str, Path(max_length=100)]) -> HTMLResponse:
    """Operator procedure of an instrument as a page without scripts from the package."""
    text = app.instruments.get(name).instrument.procedures.get(file)
    if text is None:
        raise NotFound("no such procedure", got=file)
    return HTMLResponse(single_page(present.instruments.title_of(text, file), text))


def _read(file: UploadFile) -> bytes:
    return file.file.read(MAX_ZIP_BYTES + 1)

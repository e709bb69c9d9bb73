"""Camera calibrations from frames of the camera."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import Query, Response

from gss.api import present
from gss.api.api_router import api_router
from gss.api.deps import EXPORT, App, AuditNote, RowId, User, need
from gss.api.schemas.calibrations import (
    CalibrationDetailOut,
    CalibrationDiffOut,
    CalibrationOut,
    DocumentedIn,
)
from gss.api.schemas.jobs import JobOut
from gss.api.schemas.tables import TableDetailOut
from gss.operations.studies.calibration_export import KINDS, export_calibration
from gss.operations.studies.calibration_requests import CalibrationRequest
from gss.store.models import Calibration
from gss.wiring.services import Services

router = api_router("calibrations", "/calibrations")
Identity = Annotated[int, Query(ge=1, le=2**31 - 1)]


@router.get("")
def list_calibrations(
    app: App,
    profile: Annotated[str, Query(max_length=40)] = "",
    limit: Annotated[int, Query(ge=1, le=500)] = 50,
) -> list[CalibrationOut]:
    """Calibrations, newest first. ``profile``: only this camera."""
    reports = app.transfers.tables.on_board()
    return [
        present.calibrations.calibration(row, _in_use(app, row), reports)
        for row in app.studies.calibrations.newest(limit, profile)
    ]


@router.post("", status_code=202, dependencies=[need("calibrate")])
def calibrate(app: App, user: User, body: CalibrationRequest) -> JobOut:
    """Run a calibration as a job; its result names the calibration."""
    return present.records.job(app.studies.calibrations.start(body, user=user))


@router.get("/diff")
def compare(app: App, older: Identity, newer: Identity) -> CalibrationDiffOut:
    """Differences between two calibrations."""
    return present.calibrations.difference(app.studies.calibrations.compare(older, newer))


@router.post("/documented", dependencies=[need("calibrate")])
def use_documented(app: App, user: User, body: DocumentedIn, audit_note: AuditNote) -> None:
    """Use this camera's documented values again for reruns."""
    audit_note(
        f"{body.profile} from {app.studies.calibrations.book.in_use(body.profile) or 'documented'} to documented"
    )
    app.studies.calibrations.use_documented(body.profile, user=user)


@router.get("/{calibration_id}")
def read_calibration(app: App, calibration_id: RowId) -> CalibrationDetailOut:
    """Calibration with maps and figures."""
    return _detail(app, app.studies.calibrations.get(calibration_id))


@router.post("/{calibration_id}/use", dependencies=[need("calibrate")])
def use(app: App, user: User, calibration_id: RowId, audit_note: AuditNote) -> CalibrationDetailOut:
    """Use this calibration for reruns from now on."""
    profile = app.studies.calibrations.get(calibration_id).profile
    audit_note(f"{profile} from {app.studies.calibrations.book.in_use(profile) or 'documented'} to {calibration_id}")
    return _detail(app, app.studies.calibrations.use(calibration_id, user=user))


@router.post("/{calibration_id}/table", status_code=201, dependencies=[need("calibrate")])
def make_table(app: App, user: User, calibration_id: RowId) -> TableDetailOut:
    """Create a device table from a calibration; send it from /tables."""
    return present.tables.table_detail(
        app.studies.calibrations.table(calibration_id, user=user), app.transfers.tables.on_board()
    )


@router.post("/{calibration_id}/bad-pixel-table", status_code=201, dependencies=[need("calibrate")])
def make_bad_pixel_table(app: App, user: User, calibration_id: RowId) -> TableDetailOut:
    """Create a device table from the bad pixels of a calibration; send it from /tables."""
    return present.tables.table_detail(
        app.studies.calibrations.bad_pixel_table(calibration_id, user=user), app.transfers.tables.on_board()
    )


@router.get("/{calibration_id}/export", response_class=Response, dependencies=[EXPORT])
def export(app: App, calibration_id: RowId, kind: Literal["json", "ecsv", "html", "pdf"] = "json") -> Response:
    """Export a calibration for other programs (json, ecsv), or its report (html, pdf)."""
    data = export_calibration(app.studies.calibrations.get(calibration_id), kind)
    headers = {"Content-Disposition": f"attachment; filename=calibration-{calibration_id}.{kind}"}
    return Response(data, media_type=KINDS[kind], headers=headers)


def _in_use(app: Services, row: Calibration) -> bool:
    return app.studies.calibrations.book.in_use(row.profile) == row.id if row.values else False


def _detail(app: Services, row: Calibration) -> CalibrationDetailOut:
    return present.calibrations.detail(
        row, _in_use(app, row), app.transfers.tables.on_board(), app.studies.calibrations.takes_bad_pixels(row)
    )

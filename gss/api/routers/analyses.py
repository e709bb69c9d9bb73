"""Analyses of nights and contacts."""

from __future__ import annotations

from typing import Annotated, Literal

from fastapi import Query, Response

from gss.api import present
from gss.api.api_router import api_router
from gss.api.deps import EXPORT, App, RowId, User, need
from gss.api.schemas.analyses import AnalysisDetailOut, AnalysisOut
from gss.api.schemas.calibrations import CalibrationDetailOut
from gss.api.schemas.jobs import JobOut
from gss.domain.errors import NotFound
from gss.operations.report.parts import report_from
from gss.operations.studies.analyses import EXPORTS
from gss.operations.studies.analysis_requests import AnalysisRequest
from gss.operations.studies.sheet_record import SheetValues
from gss.store.models import Analysis

router = api_router("analyses", "/analyses")


@router.get("")
def list_analyses(
    app: App, kind: Annotated[str, Query(max_length=30)] = "", limit: Annotated[int, Query(ge=1, le=500)] = 50
) -> list[AnalysisOut]:
    """Analyses, newest first. ``kind``: only this kind."""
    return [_analysis(row) for row in app.studies.analyses.newest(limit, kind)]


@router.post("", status_code=202, dependencies=[need("analyse")])
def analyse(app: App, user: User, body: AnalysisRequest) -> JobOut:
    """Run an analysis as a job; its result names the analysis."""
    return present.records.job(app.studies.analyses.start(body, user=user))


@router.get("/{analysis_id}")
def read_analysis(app: App, analysis_id: RowId) -> AnalysisDetailOut:
    """Analysis with its report."""
    row = app.studies.analyses.get(analysis_id)
    report = report_from(row.result["report"])
    return AnalysisDetailOut(**dict(_analysis(row)), request=row.request, figures=row.result["figures"], report=report)


@router.get("/{analysis_id}/sheet")
def read_sheet(app: App, analysis_id: RowId) -> SheetValues:
    """Performance sheet as one document. Available only for analyses of the kind sheet."""
    row = app.studies.analyses.get(analysis_id)
    if row.kind != "sheet":
        raise NotFound("this analysis is not a performance sheet", expected="kind sheet", got=row.kind)
    sheet: SheetValues = row.result["figures"]
    return sheet


@router.post("/{analysis_id}/calibration", status_code=201, dependencies=[need("calibrate")])
def propose_calibration(app: App, user: User, analysis_id: RowId) -> CalibrationDetailOut:
    """Store the calibration that a health analysis proposes. It can then be used, or converted to a table, like any
    calibration."""
    row = app.studies.calibrations.from_health(analysis_id, user=user)
    takes_bad_pixels = app.studies.calibrations.takes_bad_pixels(row)
    return present.calibrations.detail(row, False, app.transfers.tables.on_board(), takes_bad_pixels)


@router.get("/{analysis_id}/export", response_class=Response, dependencies=[EXPORT])
def export(app: App, analysis_id: RowId, kind: Literal["json", "html", "pdf", "tdm", "csv"] = "pdf") -> Response:
    """Export an analysis: the report (html, pdf), all data (json), the tracks of moving objects (tdm, CCSDS 503.0-B),
    or the warm pixels of a health analysis (csv)."""
    headers = {"Content-Disposition": f"attachment; filename=analysis-{analysis_id}.{kind}"}
    return Response(app.studies.analyses.export(analysis_id, kind), media_type=EXPORTS[kind], headers=headers)


def _analysis(row: Analysis) -> AnalysisOut:
    notes = row.result["report"]["notes"]
    names = ["id", "kind", "title", "created", "author", "tool"]
    severe = sum(1 for n in notes if n["severe"])
    return AnalysisOut(**{name: getattr(row, name) for name in names}, doubts=len(notes), severe=severe)

"""Analyses of nights and contacts."""

from __future__ import annotations

import math
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Query, Response

from gss.api import present
from gss.api.deps import EXPORT, App, RowId, User, need
from gss.api.schemas.analyses import AnalysisDetailOut, AnalysisIn, AnalysisOut, FrameAnalysisIn
from gss.api.schemas.jobs import JobOut
from gss.api.schemas.reports import ReportViewOut
from gss.operations.studies.analyses import EXPORTS, FrameAnalysis, TelemetryAnalysis
from gss.store.models import Analysis

router = APIRouter(prefix="/analyses", tags=["analyses"])


@router.get("")
def list_analyses(
    app: App, kind: Annotated[str, Query(max_length=30)] = "", limit: Annotated[int, Query(ge=1, le=500)] = 50
) -> list[AnalysisOut]:
    """Analyses, newest first. ``kind``: only this kind."""
    return [AnalysisOut(**_facts(row)) for row in app.analyses.newest(limit, kind)]


@router.post("", status_code=202, dependencies=[need("analyse")])
def analyse(app: App, user: User, body: AnalysisIn) -> JobOut:
    """Run an analysis as a job; its result names the analysis."""
    wanted: FrameAnalysis | TelemetryAnalysis
    if isinstance(body, FrameAnalysisIn):
        commanded = None if body.commanded_deg_s is None else math.radians(body.commanded_deg_s)
        wanted = FrameAnalysis(
            body.kind,
            body.profile,
            tuple(body.frame_ids),
            body.chain,
            commanded,
            body.other_profile,
            tuple(body.other_ids),
        )
    else:
        wanted = TelemetryAnalysis(body.contact)
    return present.records.job(app.analyses.start(wanted, body.title, user=user))


@router.get("/{analysis_id}")
def read_analysis(app: App, analysis_id: RowId) -> AnalysisDetailOut:
    """Analysis with its report."""
    row = app.analyses.get(analysis_id)
    report = ReportViewOut.model_validate(row.result["report"])
    return AnalysisDetailOut(**_facts(row), request=row.request, figures=row.result["figures"], report=report)


@router.get("/{analysis_id}/export", response_class=Response, dependencies=[EXPORT])
def export(app: App, analysis_id: RowId, kind: Literal["json", "html", "pdf"] = "pdf") -> Response:
    """Export an analysis: the report (html, pdf) or all data (json)."""
    headers = {"Content-Disposition": f"attachment; filename=analysis-{analysis_id}.{kind}"}
    return Response(app.analyses.export(analysis_id, kind), media_type=EXPORTS[kind], headers=headers)


def _facts(row: Analysis) -> dict[str, Any]:
    notes = row.result["report"]["notes"]
    names = ["id", "kind", "title", "created", "author", "tool"]
    severe = sum(1 for n in notes if n["severe"])
    return {name: getattr(row, name) for name in names} | {"doubts": len(notes), "severe": severe}

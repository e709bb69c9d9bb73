"""Results of analyses; the requests are gss.operations.studies.analysis_requests."""

from __future__ import annotations

from typing import Any

from gss.api.schemas.base import Out, Utc
from gss.api.schemas.reports import ReportViewOut


class AnalysisOut(Out):
    """Analysis. ``doubts``: number of notes in its report; ``severe``: number of notes that say not to rely on it."""

    id: int
    kind: str
    title: str
    created: Utc
    author: str
    tool: str
    doubts: int
    severe: int


class AnalysisDetailOut(AnalysisOut):
    """Analysis with its report. ``figures``: results in radians, seconds and pixels."""

    request: dict[str, Any]
    figures: dict[str, Any]
    report: ReportViewOut

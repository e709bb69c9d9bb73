"""Results of analyses. The requests are in gss.operations.studies.analysis_requests."""

from __future__ import annotations

from gss.api.schemas.base import Out, Utc
from gss.domain.json_object import JsonObject
from gss.operations.report.parts import Report


class AnalysisOut(Out):
    """Analysis. ``doubts``: number of notes in the report; ``severe``: number of notes that declare the result
    unreliable."""

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

    request: JsonObject
    figures: JsonObject
    report: Report

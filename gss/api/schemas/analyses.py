"""Requests and results of analyses."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from pydantic import Field

from gss.api.schemas.base import Id, In, Out, Utc
from gss.api.schemas.reports import ReportViewOut

ManyIds = Annotated[list[Id], Field(max_length=5000)]


class FrameAnalysisIn(In):
    """Analysis of stored frames. ``commanded_deg_s``: commanded rate of a slew; ``other_*``: second camera."""

    kind: Literal["earth-fixed", "celestial-fixed", "slew", "sensitivity", "nea", "spatial", "two-cameras"]
    profile: str = Field(max_length=40)
    frame_ids: ManyIds
    chain: str = Field(default="reference", max_length=30)
    commanded_deg_s: float | None = Field(default=None, gt=0, lt=20)
    other_profile: str = Field(default="", max_length=40)
    other_ids: ManyIds = Field(default_factory=list)
    title: str = Field(default="", max_length=120)


class TelemetryAnalysisIn(In):
    """Performance analysis of the attitudes of a contact."""

    kind: Literal["telemetry"]
    contact: Id
    title: str = Field(default="", max_length=120)


AnalysisIn = Annotated[FrameAnalysisIn | TelemetryAnalysisIn, Field(discriminator="kind")]


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

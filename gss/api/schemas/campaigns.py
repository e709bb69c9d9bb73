"""Experiments, reprocessing and comparison of chains."""

from __future__ import annotations

from pydantic import Field

from gss.api.schemas.base import In, Out
from gss.operations.report.parts import Report


class ExperimentOut(Out):
    """Experiment from a document that can be rerun. ``trials``: default number."""

    name: str
    title: str
    trials: int


class ChainRecordOut(Out):
    """Results of one version of a chain over the stored frames; medians are over solved frames. ``options``: its changed
    constants, NAME=VALUE, …. ``solved_interval``: 95 % interval (Wilson) of the solved share; ``wrong_most``: upper
    bound of the share of wrong solutions among ``judged``, by the same method."""

    chain: str
    version: str
    options: str
    frames: int
    solved: int
    solved_interval: tuple[float, float]
    verdicts: dict[str, int]
    judged: int
    wrong_most: float
    median_error_axis_arcsec: float | None
    median_rms_px: float | None
    median_time_ms: float | None


class ChainPairIn(In):
    """Chain to report on, and the one to compare it with; without ``against_chain`` each frame's operational result."""

    chain: str = Field(max_length=30)
    version: str = Field(max_length=30)
    options: str = Field(default="", max_length=2000)
    against_chain: str = Field(default="", max_length=30)
    against_version: str = Field(default="", max_length=30)
    against_options: str = Field(default="", max_length=2000)


class ChainFailureOut(Out):
    """Frame that a chain did not solve, or solved differently. ``kind``: "no solution", "wrong" or "differs"."""

    frame_id: int
    kind: str
    reason: str


class ChainReportOut(Out):
    """Report on a chain. ``failures``: the first of the ``failed`` frames."""

    report: Report
    failures: list[ChainFailureOut]
    failed: int

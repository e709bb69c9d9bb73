"""Experiments, reprocessing and comparison of chains."""

from __future__ import annotations

from pydantic import Field

from gss.api.schemas.base import In, Out
from gss.operations.report.parts import Report


class ExperimentOut(Out):
    """Experiment from a document that can be rerun. ``trials``: default number of trials."""

    name: str
    title: str
    trials: int


class ChainRecordOut(Out):
    """Results of one version of a chain over the stored frames; medians are over solved frames. ``options``: changed
    constants of the chain, NAME=VALUE, …. ``solved_interval``: 95 % interval (Wilson) of the solved share;
    ``wrong_most``: upper bound of the share of wrong solutions in ``judged`` solutions, by the same method."""

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
    """Chain of the report, and the chain to compare it with. Without ``against_chain`` it is compared with each frame's
    operational result."""

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
    """Report on a chain. ``failed``: number of failed frames; ``failures``: the first of them."""

    report: Report
    failures: list[ChainFailureOut]
    failed: int

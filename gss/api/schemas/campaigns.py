"""Experiments, reprocessing and comparison of chains."""

from __future__ import annotations

from pydantic import Field

from gss.api.schemas.base import Id, In, Out


class ExperimentOut(Out):
    """Experiment from a document that can be rerun. ``trials``: default number."""

    name: str
    title: str
    trials: int


class ExperimentsIn(In):
    """Experiments to run. The job's result holds one record for each: columns, rows, conditions, notes, series."""

    names: list[str] = Field(min_length=1, max_length=40)
    trials: int | None = Field(default=None, ge=1, le=10_000_000)
    seed: int = Field(default=1, ge=0, le=2**31 - 1)


class ReprocessIn(In):
    """Frames to reprocess, by id or by filter. ``profile``: camera for frames that have none. ``again``: include frames
    that this version of the chain has already solved."""

    chain: str = Field(min_length=1, max_length=30)
    frame_ids: list[Id] = Field(default_factory=list, max_length=100_000)
    source: str = Field(default="", max_length=10)
    contact: Id | None = None
    profile: str | None = Field(default=None, max_length=40)
    again: bool = False


class ChainRecordOut(Out):
    """Results of one version of a chain over the stored frames; medians are over solved frames. ``solved_interval``: 95
    % interval (Wilson) of the solved share; ``wrong_most``: upper bound of the share of wrong solutions among
    ``judged``, by the same method."""

    chain: str
    version: str
    frames: int
    solved: int
    solved_interval: tuple[float, float]
    verdicts: dict[str, int]
    judged: int
    wrong_most: float
    median_error_axis_arcsec: float | None
    median_rms_px: float | None
    median_time_ms: float | None

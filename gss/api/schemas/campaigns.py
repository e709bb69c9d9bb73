"""Experiments, reprocessing, comparison of chains."""

from __future__ import annotations

from pydantic import Field

from gss.api.schemas.base import Id, In, Out


class ExperimentOut(Out):
    """An experiment of a document that can be rerun; ``trials`` by default."""

    name: str
    title: str
    trials: int


class ExperimentsIn(In):
    """Which to run. The job's result holds one record each: columns, rows, conditions, notes, series."""

    names: list[str] = Field(min_length=1, max_length=40)
    trials: int | None = Field(default=None, ge=1, le=10_000_000)
    seed: int = Field(default=1, ge=0, le=2**31 - 1)


class ReprocessIn(In):
    """Frames by id, or all that the filters leave. ``profile``: camera of frames that have none. ``again``: also those that
    this chain and version have solved."""

    chain: str = Field(min_length=1, max_length=30)
    frame_ids: list[Id] = Field(default_factory=list, max_length=100_000)
    source: str = Field(default="", max_length=10)
    contact: Id | None = None
    profile: str | None = Field(default=None, max_length=40)
    again: bool = False


class ChainRecordOut(Out):
    """Results of one chain and version over the stored frames; medians over the solved ones. ``solved_interval``: of the share of
    frames, 95 % (Wilson); ``wrong_most``: the most that the share of wrong ones among ``judged`` solutions may be, likewise."""

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

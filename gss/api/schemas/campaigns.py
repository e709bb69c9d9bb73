"""Experiments, reprocessing and comparison of chains."""

from __future__ import annotations

from gss.api.schemas.base import Out


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

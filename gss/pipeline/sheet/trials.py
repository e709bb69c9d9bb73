"""Acquisition, tracking, ageing and robustness: counts of results under stated conditions."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.rotation import turn_between
from gss.pipeline.analysis.series import AttitudeSeries
from gss.pipeline.sheet.ageing import MIN_FRAMES, Ageing
from gss.pipeline.sheet.noise import steady_runs
from gss.pipeline.sheet.rows import SheetFigure, SheetRow, counted_conditions, missing, share_figure

ACQUISITION = ("acquisition", "Acquisition", "count of frames solved without prior attitude; Wilson intervals")
TRACKING = (
    "tracking",
    "Tracking",
    "count of attitudes lost from one frame to the next, and rates of the solved frames",
)
END_OF_LIFE = (
    "end-of-life",
    "End of life",
    "level, star brightness and particle hits of the frames against the calibration; frames rendered with an aged "
    "detector and lens, compared with the truth",
)
ROBUSTNESS = ("robustness", "Robustness", "frames rendered with each disturbance, solved and compared with the truth")


@dataclass(frozen=True)
class Trials:
    """Results of ``trials`` frames under one condition, compared with the truth. ``correct`` includes imprecise
    attitudes. ``cross_rad`` (k,): errors of the correct attitudes across the boresight."""

    condition: str
    trials: int
    correct: int
    false: int
    cross_rad: Array

    @property
    def none(self) -> int:
        """Return the number of frames without an attitude."""
        return self.trials - self.correct - self.false


def acquisition_row(tried: Trials | None, series: AttitudeSeries) -> SheetRow:
    """Return the row from trials with a known truth, or from frames. In frames, an attitude that contradicts its
    neighbours is false."""
    if tried is not None:
        figures = [
            share_figure("correct", tried.correct, tried.trials),
            share_figure("false", tried.false, tried.trials),
            share_figure("none", tried.none, tried.trials),
        ]
        return SheetRow(*ACQUISITION, tried.condition, tried.trials, (*figures, _frames_needed(tried)))
    if not len(series):
        return missing(*ACQUISITION, "frames of stars")
    n, solved = len(series), int(series.solved.sum())
    return SheetRow(
        *ACQUISITION,
        "each frame solved separately; false attitudes cannot be detected without a reference",
        n,
        (share_figure("attitude", solved, n), share_figure("none", n - solved, n)),
    )


def _frames_needed(tried: Trials) -> SheetFigure:
    """Return the mean number of frames until the first correct attitude. It is the inverse of the share of correct
    attitudes."""
    share = share_figure("", tried.correct, tried.trials)
    mean, low, high = (1 / v if v > 0 else float("inf") for v in (share.value, share.high, share.low))
    return SheetFigure("frames to the first attitude", mean, low, high, "frames")


def tracking_row(series: AttitudeSeries, camera: Camera) -> SheetRow:
    """Return the row for tracking, from consecutive frames."""
    runs = [r for r in steady_runs(series, camera) if len(r) >= 3]
    if not runs:
        return missing(*TRACKING, "at least three frames taken one after the other at equal intervals")
    solved, steps = series.solved, np.diff(series.times_s)
    # A frame that follows after a much longer time than usual is a new acquisition.
    soon = steps < 1.5 * float(np.quantile(steps, 0.1))
    next_soon = solved[:-1] & soon
    followed = int(np.count_nonzero(next_soon))
    lost = int(np.count_nonzero(next_soon & ~solved[1:]))
    rates, accelerations = [], []
    for run in runs:
        rate, acceleration = _motion(run)
        rates.append(rate)
        accelerations.append(acceleration)
    figures = [share_figure("loss per frame", lost, followed)] if followed else []
    top_rate, top_acceleration = (
        float(np.max(np.concatenate(rates))),
        float(np.max(np.concatenate(accelerations), initial=0.0)),
    )
    figures += [SheetFigure("largest rate tracked", top_rate, top_rate, float("inf"), "rad/s")]
    if top_acceleration > 0:
        figures += [
            SheetFigure("largest acceleration tracked", top_acceleration, top_acceleration, float("inf"), "rad/s²")
        ]
    outage = _longest_outage_s(series, soon)
    figures += [SheetFigure("longest loss", outage, outage, float("inf"), "s")]
    text = "rates and accelerations are observed values, not limits"
    return SheetRow(*TRACKING, text, len(series), tuple(figures))


def _motion(run: AttitudeSeries) -> tuple[Array, Array]:
    """Return rates (m,) and accelerations (k,) between the attitudes of a run, robust against the noise of single
    attitudes."""
    step = np.diff(run.times_s)[:, None]
    rate = turn_between(run.quaternion[:-1], run.quaternion[1:]) / step
    change = np.diff(rate, axis=0)
    noise = np.median(np.linalg.norm(change - np.median(change, axis=0), axis=1)) if len(change) else 0.0
    size = np.linalg.norm(change, axis=1)
    return np.linalg.norm(rate, axis=1), np.where(size > 5 * noise, size, 0.0) / step[1:, 0]


def _longest_outage_s(series: AttitudeSeries, soon: NDArray[np.bool_]) -> float:
    """Return the longest time without an attitude between two attitudes. ``soon`` (n − 1,): False where a frame follows so
    late that it is a new acquisition."""
    longest = 0.0
    for a, b in pairwise(np.flatnonzero(series.solved)):
        if b > a + 1 and soon[a:b].all():
            longest = max(longest, float(series.times_s[b] - series.times_s[a + 1]))
    return longest


def end_of_life_row(ageing: Ageing | None, aged: tuple[Trials, ...]) -> SheetRow:
    """Return the row with the ageing of the frames, and the results of a simulated aged unit."""
    simulated = condition_row(END_OF_LIFE, aged, f"at least {MIN_FRAMES} frames with their pixels, or a simulated unit")
    if ageing is None:
        return simulated
    measured = tuple(f for f in (ageing.dark_e_s, ageing.loss, ageing.hits) if f is not None)
    conditions = counted_conditions(
        ["dark current if the sky is as in the calibration; light lost on average over the field", simulated.conditions]
    )
    return SheetRow(*END_OF_LIFE, conditions, ageing.frames + simulated.frames, (*measured, *simulated.figures))


def condition_row(head: tuple[str, str, str], tried: tuple[Trials, ...], needs: str) -> SheetRow:
    """Return a row with the share of correct and false attitudes under each condition."""
    if not tried:
        return missing(*head, needs)
    figures: list[SheetFigure] = []
    for t in tried:
        figures.append(share_figure(f"{t.condition}: correct", t.correct, t.trials))
        figures.append(share_figure(f"{t.condition}: false", t.false, t.trials))
        if len(t.cross_rad) >= 5:
            figures.append(_error(t))
    conditions = counted_conditions([f"{t.trials} frames each" if t is tried[0] else "" for t in tried])
    return SheetRow(*head, conditions, sum(t.trials for t in tried), tuple(figures))


def _error(t: Trials) -> SheetFigure:
    """Return the root mean square error across the boresight, per axis, with the χ² interval of 2k squares (Wilson–Hilferty)."""
    k = 2 * len(t.cross_rad)
    value = float(np.sqrt(np.mean(t.cross_rad**2) / 2))
    low, high = (float((1 - 2 / (9 * k) + z * np.sqrt(2 / (9 * k))) ** 1.5) for z in (1.96, -1.96))
    return SheetFigure(f"{t.condition}: error across", value, value / low, value / high, "rad")

"""Sequential calibration: a figure filtered over the mission after its temperature dependence is subtracted."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss.domain.angles import Array
from gss.pipeline.health.trend import CLIP_SIGMAS, DAY_S, Trend

WANDERINGS = np.geomspace(1e-4, 3.0, 24)
"""Random walk per day relative to the error of one sample. The value with the highest likelihood is used."""
MIN_SCATTER = 0.1


@dataclass(frozen=True)
class FilteredCourse:
    """Filtered course of a figure: (n,) estimates at the mean temperature, each from its sample and the earlier ones,
    and their standard deviations. Before the first sample that is not an outlier, also after a jump, they are the trend
    with an infinite standard deviation. ``walk_per_day``: standard deviation of the random walk in a day."""

    values: Array
    sigma: Array
    walk_per_day: float


def filtered_course(times_s: Array, values: Array, sigma: Array, temperature_c: Array, trend: Trend) -> FilteredCourse:
    """Filter (n,) samples in order of time. The level follows the drift of the trend and a random walk; the filter
    restarts at each jump."""
    days = np.asarray(times_s, float) / DAY_S
    warmth = np.zeros(len(days))
    if trend.per_k is not None:
        off_k = np.asarray(temperature_c, float) - trend.temperature_c
        warmth = trend.per_k.value * np.where(np.isfinite(off_k), off_k, 0.0)
    at_mean = np.asarray(values, float) - warmth
    error = np.asarray(sigma, float) * max(trend.scatter, MIN_SCATTER)
    starts = np.searchsorted(times_s, [j.time_s.value for j in trend.jumps]).tolist()
    expected = trend.at(times_s)
    size = float(np.median(error))
    runs = [_run(days, at_mean - expected, error, starts, size * w) for w in WANDERINGS]
    best = int(np.argmin([misfit for _, _, misfit in runs]))
    level, spread, _ = runs[best]
    return FilteredCourse(expected + level, spread, float(size * WANDERINGS[best]))


def _run(days: Array, off: Array, error: Array, starts: list[int], walk_per_day: float) -> tuple[Array, Array, float]:
    """Return estimates, their errors, and −2 ln of the likelihood. Samples far from the estimate do not change it."""
    level, variance, misfit = 0.0, np.inf, 0.0
    levels, spread = np.empty(len(off)), np.empty(len(off))
    for k in range(len(off)):
        if k in starts:
            level, variance = 0.0, np.inf
        elif k:
            variance += walk_per_day**2 * (days[k] - days[k - 1])
        error2 = float(error[k]) ** 2
        if not np.isfinite(off[k]) or error2 <= 0:
            pass
        elif np.isinf(variance):
            # The filter does not start from an outlier, because its later estimates would stay near it.
            if float(off[k]) ** 2 < CLIP_SIGMAS**2 * error2:
                level, variance = float(off[k]), error2
        else:
            total_variance = variance + error2
            surprise = (float(off[k]) - level) ** 2 / total_variance
            misfit += min(surprise, CLIP_SIGMAS**2) + float(np.log(total_variance))
            if surprise < CLIP_SIGMAS**2:
                level += variance / total_variance * (float(off[k]) - level)
                variance *= error2 / total_variance
        levels[k], spread[k] = level, np.sqrt(variance)
    return levels, spread, misfit

"""Course of single warm pixels: onset, growth and annealing, fitted to their values in every frame.

The model of a pixel is a read-out offset, a dark current from the start, and after the onset an additional dark
current. The additional current is steady, grows linearly, or decays with a half-life to a remaining level. Dark
currents follow the temperature.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.pipeline.calibration.robust import robust_sigma
from gss.pipeline.health.trend import DAY_S, TIME_GAIN, Z95, Estimate

STEADY, ANNEALING, GROWING = "steady", "annealing", "growing"
SURE_GAIN = 45.0
"""Minimum improvement of χ² by an onset. Onsets are searched for in every candidate and at every frame. With this
limit, there is at most one false onset per megapixel."""
SHAPE_GAIN = 16.0
"""Minimum additional improvement of χ² by annealing or growth over a steady level."""
HALF_LIFE_GAIN = 3.84
LAW_ERROR = 0.02
"""Relative error of the dark current caused by errors of the dark law and the temperature. It is added to the noise of
a hot pixel."""
CLIP_SIGMAS = 6.0
MIN_FRAMES = 12
MIN_EACH_SIDE = 3
ONSETS, HALF_LIVES = 48, 28
FINE = 61
YEAR_S = 365.25 * DAY_S
DEGENERATE = 1e-9
OFFSET_SPREAD = 0.05
"""Minimum relative spread of exposure × dark factor for distinguishing an offset from a dark current."""


@dataclass(frozen=True)
class PixelCourse:
    """Course of one pixel. ``onset_s``: Unix seconds, None if it was warm from the start; ``shape``: shape of the
    course after the onset. ``first_e_s``: dark current above the typical pixel in the first frame after the onset;
    ``now_e_s``: in the last frame; both at the reference temperature of the dark course. ``half_life_s``: half-life of
    annealing; ``growth_e_s_year``: growth per year."""

    col: int
    row: int
    shape: str
    onset_s: Estimate | None
    first_e_s: Estimate
    now_e_s: Estimate
    half_life_s: Estimate | None = None
    growth_e_s_year: Estimate | None = None


@dataclass(frozen=True)
class PixelSeries:
    """Values of one pixel in n frames in order of time: ``excess_dn`` (n,), NaN under stars; ``noise_dn`` (n,) of a
    typical pixel; ``drive_s`` (n,): exposure × dark factor, which converts e/s at the reference to electrons."""

    times_s: Array
    excess_dn: Array
    noise_dn: Array
    drive_s: Array
    e_per_dn: float


@dataclass(frozen=True)
class _Grid:
    """Improvement of χ² over a pixel without onset, for s onsets and h half-lives: ``steady`` (s,), ``growing`` (s,),
    ``annealing`` (s, h). It is −inf if the pixel would become dimmer."""

    steady: Array
    growing: Array
    annealing: Array


def pixel_course(series: PixelSeries, col: int, row: int, warm_e_s: float) -> PixelCourse | None:
    """Fit one candidate; None if it has no significant onset and is not warmer than ``warm_e_s`` from the start."""
    fit = _fit_of(series)
    if fit is None:
        return None
    starts = np.unique(np.linspace(MIN_EACH_SIDE, len(fit.t) - MIN_EACH_SIDE, ONSETS).astype(np.intp))
    span_s = float(fit.t[-1] - fit.t[0])
    lives = np.geomspace(span_s / 200, 4 * span_s, HALF_LIVES)
    coarse = fit.gains(starts, lives)
    step = int(np.ceil(len(fit.t) / ONSETS)) + 1
    tried = {
        STEADY: coarse.steady[:, None],
        GROWING: coarse.growing[:, None],
        ANNEALING: coarse.annealing,
    }
    fine: dict[str, tuple[float, NDArray[np.intp], Array, Array]] = {}
    for shape, coarse_gain in tried.items():
        s, h = (int(v) for v in np.unravel_index(np.argmax(coarse_gain), coarse_gain.shape))
        near = np.arange(max(MIN_EACH_SIDE, starts[s] - step), min(len(fit.t) - MIN_EACH_SIDE, starts[s] + step) + 1)
        candidates = lives[h] * np.geomspace(0.2, 5.0, FINE)
        gains = fit.gains(near, candidates)
        profile = {STEADY: gains.steady[:, None], GROWING: gains.growing[:, None], ANNEALING: gains.annealing}[shape]
        fine[shape] = float(profile.max()), near, candidates, profile
    shape = max((GROWING, ANNEALING), key=lambda name: fine[name][0])
    if fine[shape][0] - fine[STEADY][0] <= SHAPE_GAIN:
        shape = STEADY
    gain, near, candidates, profile = fine[shape]
    if gain < SURE_GAIN:
        return _from_start(fit, col, row, warm_e_s)
    return _course(fit, col, row, shape, near, candidates, profile)


def _fit_of(series: PixelSeries) -> _Fit | None:
    measured = np.flatnonzero(np.isfinite(series.excess_dn))
    if len(measured) < MIN_FRAMES:
        return None
    y = series.excess_dn[measured].astype(float)
    # A running median follows the level of the pixel without particle hits. The shot noise is computed from it.
    smooth = np.array([np.median(y[max(0, i - 2) : i + 3]) for i in range(len(y))])
    dark_dn = np.maximum(smooth, 0)
    sigma = np.sqrt(series.noise_dn[measured] ** 2 + dark_dn / series.e_per_dn + (LAW_ERROR * dark_dn) ** 2)
    good = np.abs(y - smooth) < CLIP_SIGMAS * sigma
    measured_good = measured[good]
    if len(measured_good) < MIN_FRAMES or np.ptp(series.times_s[measured_good]) <= 0:
        return None
    rough = max(1.0, robust_sigma(np.diff(((y - smooth) / sigma)[good])) / float(np.sqrt(2)))
    return _Fit(
        series.times_s[measured_good], series.drive_s[measured_good] / series.e_per_dn, y[good], sigma[good] * rough
    )


class _Fit:
    """Weighted least squares for one pixel. The model without onset is projected out of all sums."""

    def __init__(self, t: Array, x: Array, y: Array, sigma: Array) -> None:
        self.t, self.x, self.y, self.sigma = t, x, y, sigma
        columns = [x / sigma]
        if np.std(x) > OFFSET_SPREAD * np.mean(x):
            columns.append(1 / sigma)
        self._base = np.linalg.qr(np.column_stack(columns))[0]
        scaled = y / sigma
        self._remainder = scaled - self._base @ (self._base.T @ scaled)
        self._columns = columns

    def gains(self, starts: NDArray[np.intp], lives_s: Array) -> _Grid:
        """Return the improvements of χ² for onsets at the frames ``starts`` and for the half-lives."""
        steady, growing = np.empty(len(starts)), np.empty(len(starts))
        annealing = np.empty((len(starts), len(lives_s)))
        for i, s in enumerate(starts):
            after_s, drive = self.t[s:] - self.t[s], (self.x / self.sigma)[s:]
            shapes = np.concatenate([after_s[None] / YEAR_S, np.exp2(-after_s[None] / lives_s[:, None])]) * drive
            shared, projected = drive @ self._base[s:], shapes @ self._base[s:]
            step2 = float(drive @ drive - shared @ shared)
            shape2 = np.sum(shapes**2, axis=1) - np.sum(projected**2, axis=1)
            cross = shapes @ drive - projected @ shared
            right, rights = float(drive @ self._remainder[s:]), shapes @ self._remainder[s:]
            det = step2 * shape2 - cross**2
            good = det > DEGENERATE * step2 * shape2
            safe = np.where(good, det, 1.0)
            level, shaped = (right * shape2 - rights * cross) / safe, (rights * step2 - right * cross) / safe
            # The pixel must become brighter at the onset, and the added shape must be positive.
            rises = good & (shaped > 0) & (level + np.r_[0.0, np.ones(len(lives_s))] * shaped > 0)
            gain = np.where(rises, right * level + rights * shaped, -np.inf)
            steady[i] = right**2 / step2 if right > 0 and step2 > DEGENERATE * float(drive @ drive) else -np.inf
            growing[i], annealing[i] = gain[0], gain[1:]
        return _Grid(steady, growing, annealing)

    def solve(self, start: int | None = None, shape: str = STEADY, half_life_s: float = 0.0) -> tuple[Array, Array]:
        """Return values and covariance of the parameters. The order is: level after the onset; size of the added shape,
        unless the shape is steady; parameters before the onset."""
        columns: list[Array] = []
        if start is not None:
            after_s = np.maximum(self.t - self.t[start], 0)
            since = self.x / self.sigma * (np.arange(len(self.t)) >= start)
            columns = [since]
            if shape != STEADY:
                columns.append(since * (after_s / YEAR_S if shape == GROWING else np.exp2(-after_s / half_life_s)))
        design = np.column_stack([*columns, *self._columns])
        values = np.linalg.lstsq(design, self.y / self.sigma, rcond=None)[0]
        if start is not None and shape == ANNEALING:
            after_s = np.maximum(self.t - self.t[start], 0)
            # The error of the half-life is added to the errors of the levels.
            slope = values[1] * columns[1] * np.log(2) * after_s / half_life_s
            design = np.column_stack([design, slope])
        covariance = np.linalg.pinv(design.T @ design)[: len(values), : len(values)]
        return np.asarray(values), np.asarray(covariance)


def _course(
    fit: _Fit, col: int, row: int, shape: str, near: NDArray[np.intp], lives_s: Array, profile: Array
) -> PixelCourse:
    s, h = (int(v) for v in np.unravel_index(np.argmax(profile), profile.shape))
    start, half_life = int(near[s]), float(lives_s[h])
    late = near[profile.max(axis=1) >= profile.max() - TIME_GAIN]
    onset = Estimate(
        float((fit.t[start - 1] + fit.t[start]) / 2), float(fit.t[late.min() - 1]), float(fit.t[late.max()])
    )
    values, covariance = fit.solve(start, shape, half_life)
    first, last = np.zeros(len(values)), np.zeros(len(values))
    first[0] = last[0] = 1.0
    after_s = float(fit.t[-1] - fit.t[start])
    base = 1 if shape == STEADY else 2
    first[base] = last[base] = 1.0
    life: Estimate | None = None
    growth: Estimate | None = None
    if shape == ANNEALING:
        first[1], last[1] = 1.0, float(np.exp2(-after_s / half_life))
        inside = np.flatnonzero(profile.max(axis=0) >= profile.max() - HALF_LIFE_GAIN)
        low = 0.0 if inside.min() == 0 else float(lives_s[inside.min()])
        high = float("inf") if inside.max() == len(lives_s) - 1 else float(lives_s[inside.max()])
        life = Estimate(half_life, low, high)
    if shape == GROWING:
        last[1] = after_s / YEAR_S
        growth = _estimate(values, covariance, np.eye(len(values))[1])
    first_e_s, now_e_s = _estimate(values, covariance, first), _estimate(values, covariance, last)
    return PixelCourse(col, row, shape, onset, first_e_s, now_e_s, life, growth)


def _from_start(fit: _Fit, col: int, row: int, warm_e_s: float) -> PixelCourse | None:
    """Return a pixel that was warm before the first frame. A pixel with only a read-out offset is not warm."""
    values, covariance = fit.solve()
    level = _estimate(values, covariance, np.eye(len(values))[0])
    return PixelCourse(col, row, STEADY, None, level, level) if level.low > warm_e_s else None


def _estimate(values: Array, covariance: Array, direction: Array) -> Estimate:
    value, half = float(values @ direction), Z95 * float(np.sqrt(max(float(direction @ covariance @ direction), 0.0)))
    return Estimate(value, value - half, value + half)

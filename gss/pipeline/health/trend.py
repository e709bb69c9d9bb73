"""Course of one figure over a mission: drift, dependence on temperature, jumps, and when it leaves its tolerance."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.pipeline.calibration.robust import Linear, fit_linear, robust_sigma

DAY_S = 86_400.0
Z95 = 1.96
MIN_SAMPLES = 12
MIN_EACH_SIDE = 5
"""Minimum number of samples before and after a jump."""
MAX_JUMPS = 4
JUMP_GAIN = 30.0
"""Minimum improvement of χ² by a jump. The limit is far above that of a single test, because every sample is tested for
a jump."""
TIME_GAIN = 6.0
"""Increase of χ² at the ends of the 95 % interval of a jump's time. It exceeds 3.84 because the time moves in steps."""
MIN_KELVIN = 3.0
CLIP_SIGMAS = 5.0
DRAWS = 2000
EXIT_SEED = 1
NEVER_S = 30 * 365.25 * DAY_S
"""Time after which a forecast ends. A figure that would leave its tolerance later is reported as staying within it."""


@dataclass(frozen=True)
class Estimate:
    """A value with its 95 % interval."""

    value: float
    low: float
    high: float

    def contains(self, value: float) -> bool:
        """True if the interval contains the value."""
        return self.low <= value <= self.high


@dataclass(frozen=True)
class Jump:
    """Sudden change of a figure: Unix seconds, and size in the unit of the figure."""

    time_s: Estimate
    size: Estimate


@dataclass(frozen=True)
class Trend:
    """Fitted trend of a figure: value at ``middle_s`` and ``temperature_c`` without later jumps, ``per_day``, ``per_k``
    (None if the temperature is unknown or steady), and jumps in order of time. ``scatter``: standard deviation of the
    samples about the fit, in units of their stated errors; ``used``: samples that were not rejected. ``covariance``: of
    value, ``per_day``, ``per_k`` if fitted, and the sizes of the jumps."""

    middle_s: float
    temperature_c: float
    value: Estimate
    per_day: Estimate
    per_k: Estimate | None
    jumps: tuple[Jump, ...]
    scatter: float
    used: int
    covariance: Array

    def at(self, times_s: Array, temperature_c: Array | float | None = None) -> Array:
        """Return the (n,) fitted values at Unix seconds, at the given temperatures or the mean temperature."""
        t = np.asarray(times_s, float)
        values = self.value.value + self.per_day.value * (t - self.middle_s) / DAY_S
        if self.per_k is not None and temperature_c is not None:
            values = values + self.per_k.value * (np.asarray(temperature_c, float) - self.temperature_c)
        for jump in self.jumps:
            values = values + jump.size.value * (t >= jump.time_s.value)
        return np.asarray(values)


@dataclass(frozen=True)
class ToleranceExit:
    """Time at which a figure leaves its tolerance: Unix seconds, infinite if not within 30 years. ``outside``: True if
    the figure is already out of tolerance."""

    time_s: Estimate
    outside: bool


def fit_trend(
    times_s: Array, values: Array, sigma: Array, temperature_c: Array | None = None, most_jumps: int = MAX_JUMPS
) -> Trend:
    """Fit (n,) values with standard deviations at (n,) Unix seconds. Temperatures are used if they vary by 3 K and are
    known for 12 samples and for more than half. Samples without a temperature are then ignored.

    Jumps are added one by one at the sample with the largest improvement of χ². Intervals assume independent errors of
    the size of the scatter. Raises BadInput with fewer than 12 samples.
    """
    t, y, s = (np.asarray(a, float) for a in (times_s, values, sigma))
    warm = None if temperature_c is None else np.asarray(temperature_c, float)
    good = np.isfinite(t) & np.isfinite(y) & (s > 0)
    if warm is not None:
        known = good & np.isfinite(warm)
        if known.sum() >= max(MIN_SAMPLES, good.sum() // 2 + 1):
            good = known
        else:
            warm = None
    if np.count_nonzero(good) < MIN_SAMPLES:
        raise BadInput(
            "too few samples for a trend", expected=f"{MIN_SAMPLES} or more", got=str(np.count_nonzero(good))
        )
    order = np.flatnonzero(good)[np.argsort(t[good], kind="stable")]
    t, y, s = t[order], y[order], s[order]
    middle_s = float((t[0] + t[-1]) / 2)
    columns = [np.ones(len(t)), (t - middle_s) / DAY_S]
    if np.ptp(t) <= 0:
        raise BadInput("a trend cannot be fitted to samples of a single time", expected="samples at different times")
    mean_c = float("nan") if warm is None else float(np.mean(warm[order]))
    if warm is not None and np.ptp(warm[order]) >= MIN_KELVIN:
        columns.append(warm[order] - mean_c)
    smooth = len(columns)
    jump_index: list[int] = []
    fit = fit_linear(np.column_stack(columns), y, s)
    while len(jump_index) < most_jumps:
        jump = _best_jump(np.column_stack(columns), y, s, jump_index, fit)
        if jump is None:
            break
        jump_index.append(jump)
        columns.append((np.arange(len(t)) >= jump).astype(float))
        fit = fit_linear(np.column_stack(columns), y, s)
        jump_index, columns, fit = _moved(columns, smooth, jump_index, y, s, fit)
    return _trend(t, columns, smooth, jump_index, y, s, fit, middle_s, mean_c)


def _gains(design: Array, y: Array, s: Array, fit: Linear, skip: list[int]) -> Array:
    """Return the (n,) improvements of χ² by a jump at each sample, in units of the scatter; −inf if a jump is not
    allowed. ``skip``: samples of other jumps."""
    n = len(y)
    scale = s * max(_core(fit, s), 1e-12)
    residual = np.clip(fit.residual / scale, -1e3, 1e3)
    # Isolated outliers are limited, because they must not look like a jump. Samples after a real jump must keep their
    # offset.
    smooth = np.array([np.median(residual[max(0, k - 2) : k + 3]) for k in range(n)])
    residual = np.clip(residual, smooth - CLIP_SIGMAS, smooth + CLIP_SIGMAS)
    basis = np.linalg.qr(design / scale[:, None])[0]
    residual = residual - basis @ (basis.T @ residual)
    # A step at sample k is the sum of all unit vectors from k on. Therefore the products with all steps are a reversed
    # cumulative sum.
    inverse = 1 / scale
    overlap = np.cumsum((basis * inverse[:, None])[::-1], axis=0)[::-1]
    norm = np.cumsum(inverse[::-1] ** 2)[::-1] - np.sum(overlap**2, axis=1)
    product = np.cumsum((residual * inverse)[::-1])[::-1]
    gains = np.where(norm > 1e-9 * norm.max(), product**2 / np.maximum(norm, 1e-300), -np.inf)
    allowed = np.ones(n, bool)
    allowed[:MIN_EACH_SIDE] = allowed[n - MIN_EACH_SIDE + 1 :] = False
    for k in skip:
        allowed[max(0, k - MIN_EACH_SIDE + 1) : k + MIN_EACH_SIDE] = False
    return np.where(allowed, gains, -np.inf)


def _core(fit: Linear, s: Array) -> float:
    """Return the scatter in units of the stated errors, from differences of neighbouring samples, which jumps hardly affect."""
    step = np.diff(fit.residual / s)
    return float(robust_sigma(step) / np.sqrt(2.0))


def _best_jump(design: Array, y: Array, s: Array, jump_index: list[int], fit: Linear) -> int | None:
    gains = _gains(design, y, s, fit, jump_index)
    best = int(np.argmax(gains))
    return best if gains[best] > JUMP_GAIN else None


def _moved(
    columns: list[Array], smooth: int, jump_index: list[int], y: Array, s: Array, fit: Linear
) -> tuple[list[int], list[Array], Linear]:
    """Search for each jump again with the other jumps fixed. The first jumps were located before the later jumps were
    known."""
    for j in range(len(jump_index)):
        other_columns = [c for i, c in enumerate(columns) if i != smooth + j]
        without = fit_linear(np.column_stack(other_columns), y, s)
        gains = _gains(np.column_stack(other_columns), y, s, without, [k for i, k in enumerate(jump_index) if i != j])
        best = int(np.argmax(gains))
        if np.isfinite(gains[best]):
            jump_index = [best if i == j else k for i, k in enumerate(jump_index)]
            columns = [*columns]
            columns[smooth + j] = (np.arange(len(y)) >= best).astype(float)
    return jump_index, columns, fit_linear(np.column_stack(columns), y, s)


def _trend(
    t: Array,
    columns: list[Array],
    smooth: int,
    jump_index: list[int],
    y: Array,
    s: Array,
    fit: Linear,
    middle_s: float,
    mean_c: float,
) -> Trend:
    sigma = np.sqrt(np.diag(fit.covariance))
    terms = [
        Estimate(float(c), float(c - Z95 * e), float(c + Z95 * e)) for c, e in zip(fit.coefficients, sigma, strict=True)
    ]
    jumps = []
    for j, k in enumerate(jump_index):
        other_columns = [c for i, c in enumerate(columns) if i != smooth + j]
        without = fit_linear(np.column_stack(other_columns), y, s)
        gains = _gains(np.column_stack(other_columns), y, s, without, [m for i, m in enumerate(jump_index) if i != j])
        near = np.flatnonzero(gains >= gains[k] - TIME_GAIN)
        low, high = int(min(near.min(), k)), int(max(near.max(), k))
        when = Estimate(float((t[k - 1] + t[k]) / 2), float(t[low - 1]), float(t[high]))
        jumps.append((when.value, Jump(when, terms[smooth + j])))
    order = sorted(range(len(jump_index)), key=lambda j: jumps[j][0])
    rows = [*range(smooth), *(smooth + j for j in order)]
    return Trend(
        middle_s,
        mean_c,
        terms[0],
        terms[1],
        terms[2] if smooth > 2 else None,
        tuple(jumps[j][1] for j in order),
        fit.sigma,
        int(fit.used.sum()),
        fit.covariance[np.ix_(rows, rows)],
    )


def tolerance_exit(trend: Trend, reference: float, tolerance: float, now_s: float) -> ToleranceExit:
    """Return the time at which the figure differs from ``reference`` by more than ``tolerance``, at the mean
    temperature and without further jumps. The interval is computed from the errors of the fit."""
    mean = np.array(
        [trend.value.value, trend.per_day.value, *([] if trend.per_k is None else [trend.per_k.value])]
        + [j.size.value for j in trend.jumps]
    )
    draws = np.random.default_rng(EXIT_SEED).multivariate_normal(mean, trend.covariance, DRAWS, method="svd")
    first = 2 if trend.per_k is None else 3
    days = (now_s - trend.middle_s) / DAY_S

    def exits(rows: Array) -> Array:
        off = rows[:, 0] + rows[:, 1] * days + rows[:, first:].sum(axis=1) - reference
        rate = rows[:, 1]
        remaining = np.where(rate > 0, tolerance - off, tolerance + off) / np.maximum(np.abs(rate), 1e-300)
        remaining = np.where(np.abs(off) >= tolerance, 0.0, remaining) * DAY_S
        return np.where(remaining > NEVER_S, np.inf, remaining)

    times = now_s + exits(draws)
    value = float(now_s + exits(mean[None])[0])
    low, high = (float(np.quantile(times, q, method="nearest")) for q in (0.025, 0.975))
    return ToleranceExit(Estimate(value, min(low, value), max(high, value)), value <= now_s)

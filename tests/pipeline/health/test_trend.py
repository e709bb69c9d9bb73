"""Trends: drift, temperature coefficient, jumps and tolerance exits are recovered within their intervals."""

from __future__ import annotations

import numpy as np
import pytest

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.errors import BadInput
from gss.pipeline.health.filtered import filtered_course
from gss.pipeline.health.mission import _figure
from gss.pipeline.health.trend import DAY_S, Trend, fit_trend, tolerance_exit

DRIFT, PER_K, JUMP = 0.01, 0.3, 3.0


def _mission(seed: int, jump_day: float | None) -> tuple[Array, Array, Array, Array]:
    """Return a year of 300 samples with 1 % outliers: times, values, errors, temperatures."""
    rng = np.random.default_rng(seed)
    t = np.sort(rng.uniform(0, 365 * DAY_S, 300))
    temperature_c = 20 + 8 * np.sin(t / 5e5) + rng.normal(0, 1, 300)
    sigma = rng.uniform(0.5, 1.5, 300)
    y = 100 + DRIFT * t / DAY_S + PER_K * (temperature_c - 20) + rng.normal(0, sigma) * 1.5
    y += (rng.random(300) < 0.01) * rng.normal(0, 50, 300)
    if jump_day is not None:
        y += JUMP * (t >= jump_day * DAY_S)
    return t, y, sigma, temperature_c


def _fit(seed: int, jump_day: float | None) -> Trend:
    return fit_trend(*_mission(seed, jump_day))


def test_a_mission_without_a_jump_has_none() -> None:
    """In 40 missions without a jump, at most one false jump is found; drift and temperature coefficient are within
    their intervals.
    """
    fits = [_fit(seed, None) for seed in range(40)]
    assert sum(len(f.jumps) for f in fits) <= 1
    assert sum(f.per_day.contains(DRIFT) for f in fits) >= 34
    assert sum(f.per_k is not None and f.per_k.contains(PER_K) for f in fits) >= 34


def test_a_jump_is_found_with_its_time_and_size() -> None:
    """One jump is found in every mission, and its time, its size and the drift are within their intervals in most."""
    days = np.random.default_rng(1).uniform(40, 320, 30)
    fits = [_fit(seed, float(day)) for seed, day in enumerate(days)]
    assert all(len(f.jumps) == 1 for f in fits)
    assert sum(f.jumps[0].time_s.contains(d * DAY_S) for f, d in zip(fits, days, strict=True)) >= 25
    assert sum(f.jumps[0].size.contains(JUMP) for f in fits) >= 25
    assert sum(f.per_day.contains(DRIFT) for f in fits) >= 25


def test_two_jumps_are_found_in_order_of_time() -> None:
    """Two jumps are found with their sizes and times, earlier one first."""
    t, y, sigma, temperature_c = _mission(5, 80.0)
    trend = fit_trend(t, y - 5 * (t >= 250 * DAY_S), sigma, temperature_c)
    assert [round(j.size.value) for j in trend.jumps] == [3, -5]
    assert trend.jumps[0].time_s.contains(80 * DAY_S)
    assert trend.jumps[1].time_s.contains(250 * DAY_S)


def test_the_exit_from_a_tolerance_is_predicted_within_its_interval() -> None:
    """The predicted time at which a value leaves its tolerance is within its interval in most missions."""
    within_interval = 0
    for seed in range(30):
        trend = _fit(seed, None)
        predicted = tolerance_exit(trend, 100.0, 10.0, 365 * DAY_S)
        offset = PER_K * (trend.temperature_c - 20)
        within_interval += predicted.time_s.contains((10 - offset) / DRIFT * DAY_S)
        assert not predicted.outside
    assert within_interval >= 25


def test_a_constant_value_never_leaves_its_tolerance() -> None:
    """A constant value inside its tolerance never leaves it; one outside is reported as outside."""
    rng = np.random.default_rng(3)
    t = np.linspace(0, 300 * DAY_S, 60)
    steady = fit_trend(t, rng.normal(5, 1e-6, 60), np.full(60, 1e-6))
    assert np.isinf(tolerance_exit(steady, 5.0, 1.0, t[-1]).time_s.value)
    assert tolerance_exit(steady, 3.0, 1.0, t[-1]).outside


def test_temperatures_that_do_not_vary_are_ignored() -> None:
    """Constant or missing temperatures give no temperature coefficient."""
    t, y, sigma, _ = _mission(2, None)
    assert fit_trend(t, y, sigma, np.full(len(t), 20.0)).per_k is None
    assert fit_trend(t, y, sigma, np.full(len(t), np.nan)).per_k is None


def test_temperatures_that_are_known_for_few_samples_are_ignored() -> None:
    """The temperature of eleven of twenty samples is ignored; that of twelve is used for these samples."""
    t, y, sigma, temperature_c = (a[:20] for a in _mission(2, None))
    temperature_c[11:] = np.nan
    trend = fit_trend(t, y, sigma, temperature_c)
    assert trend.per_k is None
    assert trend.used > 12
    temperature_c[19] = 30.0
    trend = fit_trend(t, y, sigma, temperature_c)
    assert trend.per_k is not None
    assert trend.used <= 12


def test_a_figure_that_cannot_be_fitted_has_no_trend() -> None:
    """A figure with few samples has no trend, and the other figures are not affected."""
    times_s, warm = np.arange(30) * DAY_S, np.full(30, np.nan)
    measured = [{"PSF width": (1.0, 0.1)} if k < 11 else {} for k in range(30)]
    camera = Camera.from_fov(640, 480, 0.3)
    assert _figure("PSF width", times_s, warm, measured, camera).trend is None
    assert _figure("centre row", times_s, warm, measured, camera).trend is None


@pytest.mark.parametrize("jump_at", [None, 60])
def test_the_filter_does_not_start_from_an_outlier(jump_at: int | None) -> None:
    """An outlier as the first sample, or as the first one after a jump, does not change later estimates."""
    t, sigma = 1.7e9 + DAY_S * np.arange(120), np.full(120, 0.02)
    y = 1000 + 0.02 * np.random.default_rng(3).normal(size=120)
    y[jump_at or 120 :] += 0.5
    unknown = np.full(120, np.nan)
    start, courses = jump_at or 0, []
    for off in (0.0, 0.4):
        y[start] += off
        courses.append(filtered_course(t, y, sigma, unknown, fit_trend(t, y, sigma)))
    later = np.arange(120) > start + 2
    assert np.abs(courses[1].values - courses[0].values)[later].max() < 0.02
    assert courses[1].sigma[later].max() < 0.02
    assert np.isinf(courses[1].sigma[start])


@pytest.mark.parametrize("count", [0, 5, 11])
def test_few_samples_are_rejected(count: int) -> None:
    """Fewer than twelve samples are rejected."""
    with pytest.raises(BadInput, match="too few samples"):
        fit_trend(np.arange(count) * DAY_S, np.ones(count), np.ones(count))


def test_samples_of_a_single_time_are_rejected() -> None:
    """Samples with identical times are rejected."""
    with pytest.raises(BadInput, match="single time"):
        fit_trend(np.zeros(20), np.arange(20.0), np.ones(20))

"""Correlation of device time with UTC, from packets with unknown delays."""

from __future__ import annotations

import numpy as np
import pytest

from gss.operations.line.clock_correlation import JUMPED_AFTER, MIN_SAMPLES, ClockTracker

START_S = 1_796_000_000.0
"""A time in 2026 as Unix time."""


def fed(seconds: int, *, drift: float = 0.0, seed: int = 1, tracker: ClockTracker | None = None, ahead_s: float = 0.0):
    """Return a tracker after ``seconds`` packets at 1 Hz, each delayed by at least 20 ms, and the true relation."""
    tracker = tracker or ClockTracker()
    delays = 0.02 + np.random.default_rng(seed).exponential(0.05, seconds)
    for k in range(seconds):
        tracker.add(START_S + k + delays[k], device_of(START_S + k, drift) + ahead_s)
    return tracker


def device_of(utc_s: float, drift: float) -> float:
    return 1000.0 + (utc_s - START_S) * (1 + drift)


def test_nothing_is_estimated_from_too_few_packets():
    """With fewer than ``MIN_SAMPLES`` packets there is no estimate."""
    for k in range(MIN_SAMPLES):
        assert fed(k).estimate() is None
    assert fed(MIN_SAMPLES).estimate() is not None


@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("drift", [0.0, 80e-6, -500e-6])
def test_the_true_time_is_within_the_uncertainty(seed, drift):
    """The true time is within the uncertainty in both directions, up to half an hour ahead, with and without drift."""
    clock = fed(300, drift=drift, seed=seed).estimate()
    for ahead_s in (0.0, 300.0, 2100.0):
        utc_s = START_S + ahead_s
        allowed_s = clock.uncertainty_at(utc_s)
        assert abs(clock.device_of(utc_s) - device_of(utc_s, drift)) < allowed_s
        assert abs(clock.utc_of(device_of(utc_s, drift)) - utc_s) < allowed_s * 1.001
    assert clock.uncertainty_at(START_S + 300) < 0.3
    assert clock.drift == pytest.approx(drift, abs=clock.drift_uncertainty)


def test_both_conversions_are_inverse():
    """``device_of`` and ``utc_of`` are inverse functions."""
    clock = fed(200, drift=1e-4).estimate()
    for utc_s in (START_S, START_S + 1e5):
        assert clock.utc_of(clock.device_of(utc_s)) == pytest.approx(utc_s, abs=1e-5)


def test_uncertainty_grows_away_from_now():
    """The uncertainty grows with the time ahead. Before the drift is measured, its bound is used."""
    young, old = fed(10).estimate(), fed(500).estimate()
    assert young.drift is None
    assert young.uncertainty_at(START_S + 86400) > 8.0
    assert old.uncertainty_at(START_S + 86400) > old.uncertainty_at(START_S + 600)


def test_a_stalled_line_is_not_a_jump_of_the_clock():
    """A few packets delayed by a stalled line are excluded, and the estimate does not change."""
    tracker = fed(100)
    before = tracker.estimate()
    for k in range(JUMPED_AFTER - 1):
        tracker.add(START_S + 105.0, device_of(START_S + 100 + k, 0.0))
    tracker.add(START_S + 105.02, device_of(START_S + 105, 0.0))
    after = tracker.estimate()
    assert after.device_of(START_S) == pytest.approx(before.device_of(START_S), abs=0.05)
    assert after.samples == before.samples + 1


@pytest.mark.parametrize("jump_s", [5.0, -5.0])
def test_the_correlation_restarts_after_a_clock_jump(jump_s):
    """After a clock jump in either direction, earlier samples are discarded and the new relation is estimated."""
    tracker = fed(100)
    for k in range(100, 120):
        tracker.add(START_S + k + 0.03, device_of(START_S + k, 0.0) + jump_s)
    clock = tracker.estimate()
    assert clock.samples <= 20
    assert clock.device_of(START_S + 120) == pytest.approx(device_of(START_S + 120, 0.0) + jump_s, abs=0.1)


def test_a_device_that_runs_faster_than_time_is_not_correlated():
    """For a device whose time runs ten times as fast, as in an accelerated simulation, there is no estimate."""
    tracker = ClockTracker()
    for k in range(100):
        tracker.add(START_S + k, 10.0 * k)
    assert tracker.estimate() is None

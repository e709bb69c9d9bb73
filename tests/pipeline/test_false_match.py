"""Probability that an accidental arrangement of stars is identified."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import binom

from gss.pipeline.identify.false_match import brightness_tail, false_match_probability, match_tail


def test_brightness_tail_is_uniform_for_random_pairs() -> None:
    """For random pairs, the probability is below x in about a fraction x of the cases."""
    rng = np.random.default_rng(1)
    values = np.array([brightness_tail(rng.normal(0, 1, 5), rng.normal(3, 1, 5), np.sqrt(2)) for _ in range(4000)])
    for x in (0.01, 0.1, 0.5):
        assert abs((values < x).mean() - x) < 4 * np.sqrt(x * (1 - x) / 4000)


def test_only_agreeing_brightness_lowers_the_probability() -> None:
    """Agreeing magnitudes give a small probability. Disagreeing magnitudes give at most one."""
    v_mag = np.array([2.0, 3.5, 4.0, 5.1])
    assert brightness_tail(v_mag + 7.1, v_mag, 1.4) < 1e-6
    assert brightness_tail(v_mag[::-1] * 3, v_mag, 0.5) <= 1.0


def test_combined_probability_is_an_upper_bound() -> None:
    """For random counts and independent uniform brightness, the probability is below x in at most a fraction x of the
    cases.
    """
    rng = np.random.default_rng(2)
    for trials, chance in ((6, 0.3), (20, 0.05), (60, 0.02)):
        counts, brightness = rng.binomial(trials, chance, 20_000), rng.random(20_000)
        values = np.array([match_tail(int(k), trials, chance, x) for k, x in zip(counts, brightness, strict=True)])
        for x in (0.001, 0.01, 0.1):
            assert (values < x).mean() < x + 4 * np.sqrt(x / 20_000)


def test_agreeing_brightness_lowers_the_combined_probability() -> None:
    """Agreement in brightness lowers the probability. Without agreement it rises at most by the number of levels."""
    assert match_tail(3, 20, 1e-3, 1e-3) < 1e-2 * match_tail(3, 20, 1e-3, 1.0)
    assert match_tail(3, 20, 1e-3, 1.0) <= 4.001 * float(binom.sf(2, 20, 1e-3))
    assert match_tail(5, 4, 0.1, 0.5) == 1.0
    assert match_tail(0, 0, 0.1, 1.0) == 1.0


def test_the_bound_grows_with_the_number_of_hypotheses() -> None:
    """The bound is proportional to the number of hypotheses and never exceeds one."""
    assert false_match_probability(100, 1e-8) == pytest.approx(1e-6)
    assert false_match_probability(1e12, 1e-8) == 1.0

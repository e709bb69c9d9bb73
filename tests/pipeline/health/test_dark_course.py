"""Dark current of the typical pixel over a mission."""

from __future__ import annotations

import numpy as np

from gss.pipeline.health.dark_course import dark_course
from gss.pipeline.health.trend import DAY_S

KELVIN_PER_INVERSE = 8286.0
ZERO_C_K = 273.15
LEVEL_E_S, GROWTH, E_PER_DN = 40.0, 0.3, 2.0


def test_intervals_contain_the_simulated_values() -> None:
    """In 20 missions of three years, each 95 % interval contains the simulated value at least 18 times: the level, the
    doubling temperature, and the growth per year, whose error includes that of the level."""
    hits = np.zeros(3, int)
    for seed in range(20):
        rng = np.random.default_rng(seed)
        days = 7.0 * np.arange(150)
        warm = 10 + 4 * np.sin(np.arange(150) / 11.0) + 0.5 * rng.normal(size=150)
        years = (days - days[-1] / 2) / 365.25
        reference_c = float(warm.mean())
        law = np.exp(KELVIN_PER_INVERSE * (1 / (reference_c + ZERO_C_K) - 1 / (warm + ZERO_C_K)))
        exposure = np.full(150, 0.2)
        level = 100 + exposure * LEVEL_E_S * (1 + GROWTH * years) * law / E_PER_DN + 0.1 * rng.normal(size=150)
        course = dark_course(1.7e9 + DAY_S * days, warm, exposure, level, np.full(150, 3.0), E_PER_DN)
        assert course.law_known
        hits += [
            course.at_reference_e_s.contains(LEVEL_E_S),
            course.doubling_k.contains(np.log(2) * (reference_c + ZERO_C_K) ** 2 / KELVIN_PER_INVERSE),
            course.growth_per_year.contains(GROWTH),
        ]
        assert course.growth_per_year.high - course.growth_per_year.low < 0.2
    assert (hits >= 18).all()

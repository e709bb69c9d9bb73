"""Warm pixels are found and dated, and their change over time is recovered; quiet pixels are not reported."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gss.pipeline.health.pixel_course import (
    ANNEALING,
    GROWING,
    STEADY,
    YEAR_S,
    PixelCourse,
    PixelSeries,
    pixel_course,
)
from gss.pipeline.health.pixel_search import BlockMaps, block_edges, candidates, trimmed_mean
from gss.pipeline.health.trend import DAY_S

FRAMES, GAIN, NOISE_DN, WARM_E_S = 400, 5.0, 1.6, 60.0
TIMES_S = np.sort(np.random.default_rng(0).uniform(0, 365 * DAY_S, FRAMES))
DRIVE_S = 0.4 * 2 ** np.sin(TIMES_S / 1e6)


def _series(dark_e_s: np.ndarray, seed: int) -> PixelSeries:
    """Return the readings of a pixel with the given dark current, with particle hits and with gaps caused by stars."""
    rng = np.random.default_rng(seed)
    charge = dark_e_s * DRIVE_S
    dn = rng.normal(0, 2) + (charge + np.sqrt(charge) * rng.normal(size=FRAMES)) / GAIN
    dn = np.round(dn + rng.normal(0, NOISE_DN, FRAMES))
    dn[rng.random(FRAMES) < 0.01] += 60
    dn[rng.random(FRAMES) < 0.03] = np.nan
    return PixelSeries(TIMES_S, dn, np.full(FRAMES, NOISE_DN), DRIVE_S, GAIN)


def _damaged(shape: str, seed: int) -> tuple[PixelCourse | None, float, float]:
    """Return the fit of a damaged pixel, its onset and its half-life in seconds."""
    rng = np.random.default_rng([seed, 1])
    peak, onset_s, life_s = 100 + rng.exponential(150), rng.uniform(30, 330) * DAY_S, rng.uniform(10, 50) * DAY_S
    age_s = np.maximum(TIMES_S - onset_s, 0)
    course = {
        STEADY: np.ones(FRAMES),
        ANNEALING: 0.3 + 0.7 * np.exp2(-age_s / life_s),
        GROWING: 1 + 2 * age_s / YEAR_S,
    }[shape]
    series = _series(np.where(onset_s <= TIMES_S, peak * course, 0.0), seed)
    return pixel_course(series, 3, 4, WARM_E_S), onset_s, life_s


@pytest.mark.parametrize("shape", [STEADY, ANNEALING, GROWING])
def test_onset_is_within_its_interval(shape: str) -> None:
    """The onset is within its interval in at least 23 of 25 cases, and the shape is recognised in at least 17."""
    fits = [_damaged(shape, seed) for seed in range(25)]
    assert all(c is not None and c.onset_s is not None for c, _, _ in fits)
    within_interval = sum(
        c is not None and c.onset_s is not None and c.onset_s.contains(onset_s) for c, onset_s, _ in fits
    )
    assert within_interval >= 23
    assert sum(c is not None and c.shape == shape for c, _, _ in fits) >= 17


def test_half_life_is_within_its_interval() -> None:
    """The half-life of annealing pixels is within its interval in at least 85 % of the cases."""
    fits = [_damaged(ANNEALING, seed) for seed in range(40)]
    lives = [(c.half_life_s, life_s) for c, _, life_s in fits if c is not None and c.half_life_s is not None]
    assert len(lives) >= 35
    assert sum(e.contains(life_s) for e, life_s in lives) >= 0.85 * len(lives)


def test_a_pixel_that_is_warm_from_the_start_has_no_onset() -> None:
    """A pixel that was warm throughout is reported with its dark current and without an onset."""
    course = pixel_course(_series(np.full(FRAMES, 300.0), 1), 7, 8, WARM_E_S)
    assert course is not None
    assert course.onset_s is None
    assert course.now_e_s.value == pytest.approx(300, rel=0.05)


def test_quiet_pixels_and_a_constant_offset_are_not_warm() -> None:
    """None of 100 quiet pixels is reported, nor is a constant offset without dark current."""
    quiet = [pixel_course(_series(np.zeros(FRAMES), seed), 0, 0, WARM_E_S) for seed in range(100)]
    assert quiet == [None] * 100
    series = _series(np.zeros(FRAMES), 5)
    shifted = PixelSeries(series.times_s, series.excess_dn + 40, series.noise_dn, series.drive_s, GAIN)
    assert pixel_course(shifted, 0, 0, WARM_E_S) is None


def test_a_pixel_without_readings_gives_no_result() -> None:
    """A pixel without any reading gives no result, nor do readings of a single time."""
    series = PixelSeries(TIMES_S, np.full(FRAMES, np.nan), np.full(FRAMES, NOISE_DN), DRIVE_S, GAIN)
    assert pixel_course(series, 0, 0, WARM_E_S) is None
    warm = replace(_series(np.full(FRAMES, 300.0), 1), times_s=np.full(FRAMES, TIMES_S[0]))
    assert pixel_course(warm, 0, 0, WARM_E_S) is None


def test_particles_and_stars_do_not_affect_the_trimmed_mean() -> None:
    """Single outliers and missing readings do not affect the trimmed mean."""
    values = np.zeros((5, 2, 3), np.float32)
    values[1, 0, 0] = 500
    values[:, 1, 1] = np.nan
    values[2, 0, 2] = np.nan
    values[3, 0, 2] = 300
    assert not trimmed_mean(values).any()


def test_candidates_include_all_changed_pixels_and_few_others() -> None:
    """The search returns all changed pixels and fewer than 60 candidates in total."""
    rng = np.random.default_rng(2)
    pattern = rng.normal(0, 1, (100, 120)).astype(np.float32)
    changed = rng.choice(100 * 120, 20, replace=False)
    edges = block_edges(200)
    maps = BlockMaps(edges)
    for k in range(200):
        excess = pattern + rng.normal(0, NOISE_DN, pattern.shape).astype(np.float32)
        if k >= 90:
            excess.ravel()[changed] += 8
        maps.add(excess)
    candidate_pixels = candidates(maps.maps)
    assert set(changed) <= set(candidate_pixels)
    assert len(candidate_pixels) < 60


@pytest.mark.parametrize("count", [1, 7, 30, 199, 5000])
def test_blocks_contain_every_frame_once(count: int) -> None:
    """Blocks cover all frames without overlap and have at least five frames each, unless there are fewer."""
    edges = block_edges(count)
    assert (edges[0], edges[-1]) == (0, count)
    assert min(np.diff(edges)) >= min(count, 5)

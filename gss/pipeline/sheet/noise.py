"""Temporal noise of the attitude: noise equivalent angle, Allan deviation and power spectrum per axis."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.errors import GssError
from gss.domain.rotation import turn_between
from gss.pipeline.analysis.series import AttitudeSeries
from gss.pipeline.analysis.steady import celestial_fixed
from gss.pipeline.analysis.telemetry import telemetry_statistics
from gss.pipeline.calibration.robust import robust_sigma
from gss.pipeline.sheet.rows import consecutive_blocks, interval, resampled

STILL_PX = 0.25
"""Maximum motion of the image from frame to frame for which spatial errors hardly change."""
MIN_TRIPLES = 20
BLOCK = 6
MIN_STEPS = 8


@dataclass(frozen=True)
class TemporalNoise:
    """Temporal noise of the attitude. ``nea_rad`` (3,): 1 σ of one attitude with its 95 % interval. ``allan_s`` (k,):
    averaging times; ``allan_rad`` (k, 3): Allan deviation of the angle; ``frequency_hz`` (f,), ``psd_rad2_hz`` (f, 3):
    one-sided spectrum; all empty without a steady run. ``still``: True if the stars moved less than ``STILL_PX`` from
    frame to frame; ``motion_px``: median motion. ``frames``: number of attitudes compared."""

    nea_rad: Array
    low_rad: Array
    high_rad: Array
    allan_s: Array
    allan_rad: Array
    frequency_hz: Array
    psd_rad2_hz: Array
    still: bool
    motion_px: float
    frames: int


def temporal_noise(series: AttitudeSeries, camera: Camera, rng: np.random.Generator) -> TemporalNoise | None:
    """Measure the noise from consecutive attitudes. None if too few are equally spaced in time.

    Each attitude is compared with its neighbours, so that slow errors cancel. Triples with a still image are preferred.
    """
    runs = [r for r in steady_runs(series, camera) if len(r) >= 5]
    parts = []
    for run in runs:
        try:
            statistics = telemetry_statistics(run)
        except GssError:
            continue
        step_s = float(np.median(np.diff(run.times_s)))
        parts.append((statistics.deviation_rad, statistics.rate_rad_s * step_s / camera.pixel_rad, run))
    if not parts:
        return None
    deviation = np.concatenate([p[0] for p in parts])
    motion = np.concatenate([p[1] for p in parts])
    still = np.asarray(motion < STILL_PX)
    calm = bool(np.count_nonzero(still) >= MIN_TRIPLES)
    use = still if calm else np.ones(len(motion), bool)
    if np.count_nonzero(use) < MIN_TRIPLES:
        return None
    chosen = deviation[use]

    def sigma(index: NDArray[np.intp]) -> Array:
        return np.asarray(np.array([robust_sigma(chosen[index, k]) for k in range(3)]) / np.sqrt(1.5))

    low, high = interval(resampled(consecutive_blocks(len(chosen), BLOCK), sigma, rng))
    steady = max((p[2] for p in parts if not calm or np.median(p[1]) < STILL_PX), key=len, default=None)
    allan = _curves(steady) if steady is not None else (np.zeros(0), np.zeros((0, 3)), np.zeros(0), np.zeros((0, 3)))
    value = sigma(np.arange(len(chosen)))
    return TemporalNoise(value, low, high, *allan, calm, float(np.median(motion[use])), int(np.count_nonzero(use)))


def steady_runs(series: AttitudeSeries, camera: Camera) -> list[AttitudeSeries]:
    """Split the solved frames at gaps in time (steps that differ by a fifth from the previous step) and between frames
    whose fields have little in common."""
    good = series.only(series.solved)
    if len(good) < 2:
        return []
    steps = np.diff(good.times_s)
    before = np.r_[steps[:1], steps[:-1]]
    turn = np.linalg.norm(turn_between(good.quaternion[:-1], good.quaternion[1:]), axis=1)
    cuts = (
        np.flatnonzero((np.abs(steps - before) > 0.2 * np.minimum(steps, before)) | (turn > min(camera.fov_rad) / 2))
        + 1
    )
    bounds = [0, *cuts.tolist(), len(good)]
    return [good.only(np.arange(a, b)) for a, b in pairwise(bounds) if b > a]


def allan_deviation(values: Array, step_s: float) -> tuple[Array, Array]:
    """Return averaging times (k,) and the overlapping Allan deviation (k, c) of (n, c) angles: √(½⟨(ȳ₂ − ȳ₁)²⟩) of the
    means of adjacent groups (IEEE Std 1139). For white noise it decreases with the square root of the time."""
    n = len(values)
    groups = [m for m in (2**k for k in range(int(np.log2(max(n, 2))))) if n - 2 * m + 1 >= MIN_STEPS]
    sums = np.vstack([np.zeros((1, values.shape[1])), np.cumsum(values, axis=0)])
    deviations = []
    for m in groups:
        means = (sums[m:] - sums[:-m]) / m
        deviations.append(np.sqrt(0.5 * np.mean((means[m:] - means[:-m]) ** 2, axis=0)))
    return np.array(groups, float) * step_s, np.array(deviations).reshape(len(groups), values.shape[1])


def _curves(run: AttitudeSeries) -> tuple[Array, Array, Array, Array]:
    """Return Allan deviation and power spectrum of the deviations from a constant rotation."""
    from scipy.signal import welch  # imported here because the import takes half a second

    step_s = float(np.median(np.diff(run.times_s)))
    deviation = celestial_fixed(run).deviation_rad
    times_s, allan = allan_deviation(deviation, step_s)
    frequency, power = welch(deviation, fs=1 / step_s, nperseg=min(len(deviation), 64), axis=0, detrend="linear")
    return times_s, allan, np.asarray(frequency[1:]), np.asarray(power[1:])

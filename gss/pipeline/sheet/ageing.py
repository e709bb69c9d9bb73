"""Ageing of the detector and the lens, from the pixels of solved frames: dark current, light loss and particle hits."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.sensor import Sensor
from gss.pipeline.health.frame_figures import HealthFrame, count_hits, lost_light_mag, over_sky
from gss.pipeline.health.pixel_search import trimmed_mean
from gss.pipeline.sheet.rows import SheetFigure, interval, resampled

MIN_FRAMES, MAX_FRAMES = 8, 24
MAX_PIXELS = 40_000_000
"""Maximum number of pixels of the frames in memory."""
LEVEL_ERROR = 0.05
"""Error of the level as a share of the noise of a pixel: light of stars below the detection limit, and clipping."""
Z95 = 1.96


@dataclass(frozen=True)
class Ageing:
    """Ageing of a unit relative to its calibration. ``frames``: number of frames used. ``dark_e_s``: dark current, if the
    sky is as bright as in the calibration; ``loss``: share of the light lost, averaged over the field; ``hits``:
    particle hits per frame. The figures have 95 % intervals. ``loss`` is None without bright stars."""

    frames: int
    dark_e_s: SheetFigure
    loss: SheetFigure | None
    hits: SheetFigure


def ageing_of(frames: Sequence[HealthFrame], sensor: Sensor, rng: np.random.Generator) -> Ageing | None:
    """Measure the ageing from frames at different attitudes. None with fewer than eight solved frames. ``sensor``: the
    calibration."""
    solved = [f for f in frames if f.solved]
    if len(solved) < MIN_FRAMES:
        return None
    size = solved[0].pixels().size
    count = min(len(solved), MAX_FRAMES, max(MIN_FRAMES, MAX_PIXELS // size))
    chosen = [solved[k] for k in np.linspace(0, len(solved) - 1, count).astype(int)]
    dark_e_s, lost, frame_of, excess, noise = [], [], [], [], []
    for k, frame in enumerate(chosen):
        sky = over_sky(frame, frame.pixels(), sensor)
        dark_e_s.append((sky.level_dn - sensor.bias_dn) * sensor.gain_e_per_dn / frame.exposure_s)
        assert frame.result is not None  # noqa: S101 - the frame is solved
        off, _ = lost_light_mag(frame.result, frame, sky.excess_dn, sky.noise_dn, sensor)
        lost.append(off)
        frame_of.append(np.full(len(off), k, np.intp))
        excess.append(sky.dark_dn)
        noise.append(sky.noise_dn)
    usual = trimmed_mean(np.stack(excess))
    hits = [count_hits(e, usual, n, sensor.gain_e_per_dn) for e, n in zip(excess, noise, strict=True)]
    level_error_dn = LEVEL_ERROR * np.array(noise)
    exposure_s = np.array([f.exposure_s for f in chosen])
    return Ageing(
        count,
        _dark(
            np.array(dark_e_s) - sensor.background_e_s,
            float(np.median(level_error_dn / exposure_s)) * sensor.gain_e_per_dn,
            rng,
        ),
        _loss(np.concatenate(lost), np.concatenate(frame_of), rng),
        _per_frame(sum(hits), count),
    )


def _dark(dark_e_s: Array, error_e_s: float, rng: np.random.Generator) -> SheetFigure:
    frames = np.arange(len(dark_e_s), dtype=np.intp)
    low, high = interval(resampled(frames, lambda index: np.asarray(np.mean(dark_e_s[index])), rng))
    return SheetFigure("dark current", float(dark_e_s.mean()), float(low) - error_e_s, float(high) + error_e_s, "e/s")


def _loss(lost_mag: Array, frame_of: NDArray[np.intp], rng: np.random.Generator) -> SheetFigure | None:
    if len(np.unique(frame_of)) < MIN_FRAMES:
        return None

    def share(index: NDArray[np.intp]) -> Array:
        return np.asarray(1 - 10 ** (-0.4 * np.median(lost_mag[index])))

    low, high = interval(resampled(frame_of, share, rng))
    return SheetFigure("light lost", float(share(np.arange(len(lost_mag)))), float(low), float(high), "share")


def _per_frame(hits: int, frames: int) -> SheetFigure:
    """Return the hits per frame with the 95 % interval of a Poisson count (Wilson–Hilferty)."""
    low = hits * (1 - 1 / (9 * hits) - Z95 / (3 * np.sqrt(hits))) ** 3 if hits else 0.0
    more = hits + 1
    high = more * (1 - 1 / (9 * more) + Z95 / (3 * np.sqrt(more))) ** 3
    return SheetFigure("particle hits per frame", hits / frames, float(low / frames), float(high / frames), "1")

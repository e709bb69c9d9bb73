"""Ageing of a simulated detector: pixels damaged by protons, their annealing and growth, and particle hits over the Earth."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.pipeline.chip import Chip
from gss.pipeline.readout import HotPixel

ANOMALY_RAD = (float(np.radians(-26.0)), float(np.radians(-49.0)))
"""Latitude and longitude of the middle of the South Atlantic Anomaly at 500 km."""
ANOMALY_WIDTH_RAD = (float(np.radians(11.0)), float(np.radians(23.0)))
MAX_TRACK_PX = 6


@dataclass(frozen=True)
class Radiation:
    """Radiation environment of a detector. ``damaged_per_day``: number of new warm pixels per day on the whole
    detector; ``damage_e_s``: mean dark current of the new warm pixels; ``annealing``, ``growing``: share of these
    pixels whose dark current anneals, and share whose dark current grows; ``half_life_days``: range of annealing
    half-lives; ``remaining``: largest share of the damage that does not anneal. ``hits_s``: particle hits per second
    far from the South Atlantic Anomaly; ``anomaly_hits_s``: particle hits per second in the middle of the anomaly;
    ``hit_e``: mean charge of a hit."""

    damaged_per_day: float = 0.5
    damage_e_s: float = 400.0
    annealing: float = 0.5
    growing: float = 0.1
    half_life_days: tuple[float, float] = (10.0, 60.0)
    remaining: float = 0.5
    hits_s: float = 0.3
    anomaly_hits_s: float = 100.0
    hit_e: float = 1500.0


@dataclass(frozen=True)
class DamagedPixels:
    """m damaged pixels: ``place`` (m,) flat indices, ``onset_day``, ``peak_e_s``, ``remaining`` (share of the peak that
    does not anneal), ``half_life_days`` (infinite if the pixel does not anneal), ``growth_per_year`` (relative to the
    peak)."""

    place: NDArray[np.intp]
    onset_day: Array
    peak_e_s: Array
    remaining: Array
    half_life_days: Array
    growth_per_year: Array

    def dark_e_s(self, day: float) -> Array:
        """Return the (m,) additional dark currents on a day, in e/s; 0 before the onset."""
        age = np.maximum(day - self.onset_day, 0.0)
        unannealed = self.remaining + (1 - self.remaining) * np.exp2(-age / self.half_life_days)
        return np.where(day >= self.onset_day, self.peak_e_s * (unannealed + self.growth_per_year * age / 365.25), 0.0)


def damage_of(radiation: Radiation, camera: Camera, days: float, seed: int) -> DamagedPixels:
    """Return the pixels damaged in the first ``days``. For the same seed, a longer mission begins with the same damaged
    pixels."""
    rng = np.random.default_rng(np.random.SeedSequence([seed, 7, camera.rows, camera.columns]))
    max_count = camera.rows * camera.columns // 2
    count, day = 0, 0.0
    rows: list[tuple[float, ...]] = []
    while count < max_count and radiation.damaged_per_day > 0:
        day += float(rng.exponential(1 / radiation.damaged_per_day))
        draws = rng.random(5)
        peak, index = float(rng.exponential(radiation.damage_e_s)), int(rng.integers(camera.rows * camera.columns))
        if day > days:
            break
        anneals = draws[0] < radiation.annealing
        grows = not anneals and draws[0] < radiation.annealing + radiation.growing
        low, high = radiation.half_life_days
        rows.append(
            (
                index,
                day,
                peak,
                radiation.remaining * draws[1] if anneals else 1.0,
                low + (high - low) * draws[2] if anneals else np.inf,
                1 + 2 * draws[3] if grows else 0.0,
            )
        )
        count += 1
    table = np.array(rows, float).reshape(-1, 6)
    return DamagedPixels(table[:, 0].astype(np.intp), *table[:, 1:].T)


def aged(chip: Chip, damage: DamagedPixels, day: float) -> Chip:
    """Return the chip with the additional dark current of its damaged pixels on a day."""
    dark = chip.dark_e_s.copy()
    np.add.at(dark.reshape(-1), damage.place, damage.dark_e_s(day).astype(np.float32))
    return replace(chip, dark_e_s=dark)


def hit_rate_s(radiation: Radiation, lat_rad: float, lon_rad: float) -> float:
    """Return the particle hits per second above a latitude and longitude."""
    east = (lon_rad - ANOMALY_RAD[1] + np.pi) % (2 * np.pi) - np.pi
    z2 = ((lat_rad - ANOMALY_RAD[0]) / ANOMALY_WIDTH_RAD[0]) ** 2 + (east / ANOMALY_WIDTH_RAD[1]) ** 2
    return float(radiation.hits_s + (radiation.anomaly_hits_s - radiation.hits_s) * np.exp(-z2 / 2))


def particle_hits(
    radiation: Radiation, rate_s: float, exposure_s: float, camera: Camera, rng: np.random.Generator
) -> tuple[list[HotPixel], int]:
    """Simulate the particle hits of one exposure. Returns the pixels that were hit and the number of particles. The
    hits affect only this frame. Most particles hit a single pixel; some leave a short track."""
    count = int(rng.poisson(rate_s * exposure_s))
    hits = []
    for _ in range(count):
        col, row = rng.uniform(0, camera.columns), rng.uniform(0, camera.rows)
        length, direction = min(rng.geometric(0.6), MAX_TRACK_PX), rng.uniform(0, 2 * np.pi)
        charge_e = rng.exponential(radiation.hit_e)
        for step in range(length):
            c, r = int(col + step * np.cos(direction)), int(row + step * np.sin(direction))
            if 0 <= c < camera.columns and 0 <= r < camera.rows:
                hits.append(HotPixel(c, r, charge_e / length / exposure_s))
    return hits, count

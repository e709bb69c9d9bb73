"""A simulated year of frames with ageing, passages through the South Atlantic Anomaly and jumps. Frames are rendered
when they are read."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera_profile import CameraProfile
from gss.domain.results import SolveResult
from gss.domain.rotation import matrix_from_quaternion, random_quaternion
from gss.domain.sensor import Defects
from gss.domain.stars import StarTable
from gss.pipeline.ageing import DamagedPixels, Radiation, aged, damage_of, hit_rate_s, particle_hits
from gss.pipeline.chip import Chip, make_chip
from gss.pipeline.health.frame_figures import HealthFrame
from gss.pipeline.health.trend import DAY_S
from gss.pipeline.render import render

START_S = 1_767_225_600.0  # 2026-01-01
DAYS = 365.0
WARM_C, SWING_C, NOISE_C = 20.0, 9.0, 1.5
SWING_DAYS = 61.0
DARK_EXPONENT_K = 7_400.0
"""Exponent of the diode law. With this value the dark current doubles every 8 °C."""
ZERO_C_K = 273.15
RADIATION = Radiation(damaged_per_day=0.4)
DEFECTS = Defects(
    response_sigma=0.01,
    offset_sigma_dn=0.4,
    column_sigma_dn=0.1,
    dark_sigma=0.1,
    hot_share=2e-5,
    hot_e_s=800.0,
    dead_share=0.0,
    corner_loss=0.2,
)
FOCAL_PER_DAY = -4e-7
FOCAL_PER_K = 1.5e-5
FOCAL_JUMP = (130.0, -4e-4)
"""Day of the jump, and change as a fraction of the focal length."""
LIGHT_JUMP = (250.0, 0.15)
"""Day of the jump, and loss in magnitudes."""
FADING_MAG_YEAR = {"blue": 0.20, "white": 0.12, "red": 0.08}
WIDTH_PER_YEAR = 0.12
DARK_PER_YEAR = 0.3
ORBIT_S = 5_677.0
INCLINATION_RAD = float(np.radians(97.5))


@dataclass(frozen=True)
class TrueFrame:
    """True values of a rendered frame. ``day``: day of the year. ``hits``: number of particles. ``rate_s``: particle
    rate at the position."""

    day: float
    hits: int
    rate_s: float


@dataclass(frozen=True)
class Year:
    """Frames of a year with their true values and the damaged pixels. ``chip``: detector at the start."""

    frames: list[HealthFrame]
    true: list[TrueFrame]
    damage: DamagedPixels
    chip: Chip


def year(
    profile: CameraProfile,
    stars: StarTable,
    count: int,
    seed: int,
    solve: Callable[[NDArray[Any]], SolveResult],
    progress: Callable[[float], None],
) -> Year:
    """Return a year of ``count`` frames at random attitudes in a polar orbit. ``solve``: function that solves the
    pixels of a frame."""
    rng = np.random.default_rng([seed, 3])
    chip = make_chip(DEFECTS, profile.sensor, profile.camera, seed)
    damage = damage_of(RADIATION, profile.camera, DAYS, seed)
    days = np.sort(rng.uniform(0, DAYS, count))
    frames, true = [], []
    for k, day in enumerate(days):
        progress(k / count)
        warm = temperature_c(float(day)) + float(rng.normal(0, NOISE_C))
        place = below(float(day) * DAY_S)
        attitude = matrix_from_quaternion(random_quaternion(rng))
        drawn = partial(_drawn, profile, stars, chip, damage, float(day), warm, place, attitude, (seed, 4, k))
        pixels, hits = drawn()
        frames.append(
            HealthFrame(
                f"frame {k + 1}",
                START_S + float(day) * DAY_S,
                profile.sensor.exposure_s,
                partial(_pixels, drawn),
                solve(pixels),
                stars,
                warm,
                place,
            )
        )
        true.append(TrueFrame(float(day), hits, hit_rate_s(RADIATION, *place)))
    return Year(frames, true, damage, chip)


def temperature_c(day: float) -> float:
    """Return the temperature of the sensor, which varies with the eclipses."""
    return WARM_C + SWING_C * float(np.sin(2 * np.pi * day / SWING_DAYS))


def dark_factor(warm_c: float) -> float:
    """Return the dark current relative to the dark current at the mean temperature (Jacobs 1995 eq. H.1–H.2)."""
    return float(np.exp(DARK_EXPONENT_K * (1 / (WARM_C + ZERO_C_K) - 1 / (warm_c + ZERO_C_K))))


def below(time_s: float) -> tuple[float, float]:
    """Return latitude and longitude of the ground point below a circular polar orbit."""
    angle = 2 * np.pi * time_s / ORBIT_S
    lat = np.arcsin(np.sin(INCLINATION_RAD) * np.sin(angle))
    lon = np.arctan2(np.cos(INCLINATION_RAD) * np.sin(angle), np.cos(angle)) - 2 * np.pi * time_s / 86_164.0
    return float(lat), float((lon + np.pi) % (2 * np.pi) - np.pi)


def focal_factor(day: Array | float, warm_c: Array | float) -> Array:
    """Return the focal length relative to the calibrated focal length."""
    day = np.asarray(day, float)
    drift = FOCAL_PER_DAY * day + FOCAL_PER_K * (np.asarray(warm_c, float) - WARM_C)
    return np.asarray(1 + drift + FOCAL_JUMP[1] * (day >= FOCAL_JUMP[0]))


def fading_mag(day: float, b_v: Array) -> Array:
    """Return the (n,) loss in magnitudes of stars of (n,) colours."""
    colour = np.where(b_v < 0.3, "blue", np.where(b_v < 0.8, "white", "red"))
    per_year = np.vectorize(FADING_MAG_YEAR.get)(colour).astype(float)
    return np.asarray(per_year * day / 365.25 + LIGHT_JUMP[1] * (day >= LIGHT_JUMP[0]))


def _pixels(drawn: Callable[[], tuple[NDArray[Any], int]]) -> NDArray[Any]:
    return drawn()[0]


def _drawn(
    profile: CameraProfile,
    stars: StarTable,
    chip: Chip,
    damage: DamagedPixels,
    day: float,
    warm_c: float,
    place: tuple[float, float],
    attitude: Array,
    seed: tuple[int, ...],
) -> tuple[NDArray[Any], int]:
    rng = np.random.default_rng(seed)
    factor = float(focal_factor(day, warm_c))
    camera, sensor = profile.camera, profile.sensor
    hits, count = particle_hits(RADIATION, hit_rate_s(RADIATION, *place), sensor.exposure_s, camera, rng)
    drawn = render(
        replace(stars, v_mag=stars.v_mag + fading_mag(day, stars.b_v)),
        replace(camera, focal_col_px=camera.focal_col_px * factor, focal_row_px=camera.focal_row_px * factor),
        replace(
            sensor,
            psf_sigma_px=sensor.psf_sigma_px * (1 + WIDTH_PER_YEAR * day / 365.25),
            dark_current_e_s=sensor.dark_current_e_s * (1 + DARK_PER_YEAR * day / 365.25),
        ),
        attitude,
        sensor.exposure_s,
        rng,
        chip=aged(chip, damage, day),
        hot_pixels=hits,
        dark_factor=dark_factor(warm_c),
    )
    return drawn.pixels, count

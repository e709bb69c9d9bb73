"""Simulated unit with chosen errors. Its frames test the performance sheet and predict the sheet of a planned camera."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.domain.aberration import aberrate
from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.results import SolveResult, Truth
from gss.domain.rotation import (
    matrix_from_quaternion,
    quaternion_from_matrix,
    random_quaternion,
    rotation_from_vector,
)
from gss.domain.sensor import Sensor
from gss.domain.stars import StarTable
from gss.pipeline.ageing import Radiation, particle_hits
from gss.pipeline.analysis.series import AttitudeSeries, series_of
from gss.pipeline.chip import Chip
from gss.pipeline.health.frame_figures import HealthFrame
from gss.pipeline.readout import HotPixel
from gss.pipeline.render import FalseStar, Lights, Rendered, render
from gss.pipeline.sheet.ageing import Ageing
from gss.pipeline.sheet.collect import pointing_blocks, star_sightings
from gss.pipeline.sheet.heads import ReferenceInput
from gss.pipeline.sheet.sheet import SheetInput
from gss.pipeline.veil import Veil

CALIBRATED_C = 20.0
"""Temperature at which the mounting was aligned, °C."""
Solve = Callable[[NDArray[Any], "Moment"], SolveResult]
"""Function that solves a frame without prior attitude."""


@dataclass(frozen=True)
class Moment:
    """State at the stated time of a frame: ``cam_from_icrs`` (3, 3), attitude of the body in the camera's nominal axes;
    ``rate_rad_s`` (3,), ``temperature_c``, ``velocity_c`` (3,) of the observer."""

    time_s: float
    cam_from_icrs: Array
    rate_rad_s: tuple[float, float, float] = (0.0, 0.0, 0.0)
    temperature_c: float = CALIBRATED_C
    velocity_c: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Disturbance:
    """Light and particles in addition to the stars; see :func:`gss.pipeline.render.render`."""

    title: str = ""
    false_stars: tuple[FalseStar, ...] = ()
    hot_pixels: tuple[HotPixel, ...] = ()
    lights: Lights | None = None
    veil: Veil | None = None


@dataclass(frozen=True)
class RenderedUnit:
    """True properties of a unit. ``camera``: real lens; ``chip``: detector. ``bias_rad`` (3,) and ``thermal_rad_k``
    (3,): deviation of the mounting from the nominal mounting. ``date_s``: delay of a frame after its stated time.
    ``radiation``: particles hit the detector at its rate ``hits_s``."""

    camera: Camera
    sensor: Sensor
    stars: StarTable
    exposure_s: float
    chip: Chip | None = None
    bias_rad: tuple[float, float, float] = (0.0, 0.0, 0.0)
    thermal_rad_k: tuple[float, float, float] = (0.0, 0.0, 0.0)
    date_s: float = 0.0
    radiation: Radiation | None = None

    def apparent(self, at: Moment) -> StarTable:
        """Return the stars at their apparent places for the velocity at one of its moments."""
        velocity = np.array(at.velocity_c)
        return replace(self.stars, icrs=aberrate(self.stars.icrs, velocity)) if velocity.any() else self.stars

    def frame(
        self, at: Moment, rng: np.random.Generator, disturbed: Disturbance | None = None, dark_factor: float = 1.0
    ) -> Rendered:
        """Render the frame that the unit takes at one of its moments."""
        rate = np.array(at.rate_rad_s)
        mounting = np.array(self.bias_rad) + np.array(self.thermal_rad_k) * (at.temperature_c - CALIBRATED_C)
        attitude = rotation_from_vector(mounting) @ rotation_from_vector(-rate * self.date_s) @ at.cam_from_icrs
        extra = disturbed if disturbed is not None else Disturbance()
        hits: list[HotPixel] = []
        if self.radiation is not None:
            hits, _ = particle_hits(self.radiation, self.radiation.hits_s, self.exposure_s, self.camera, rng)
        return render(
            self.apparent(at),
            self.camera,
            self.sensor,
            attitude,
            self.exposure_s,
            rng,
            rate_rad_s=rate,
            chip=self.chip,
            false_stars=extra.false_stars,
            hot_pixels=(*extra.hot_pixels, *hits),
            lights=extra.lights,
            veil=extra.veil,
            dark_factor=dark_factor,
        )


@dataclass(frozen=True)
class Observation:
    """One solved frame of a simulated unit. ``pixels``: None if the frame was not kept."""

    moment: Moment
    result: SolveResult
    truth: Truth
    pixels: NDArray[Any] | None = None


def observe(
    unit: RenderedUnit,
    moments: Sequence[Moment],
    solve: Solve,
    rng: np.random.Generator,
    progress: Callable[[int], None] = lambda _: None,
) -> list[Observation]:
    """Render and solve a frame for each moment."""
    observations = []
    for k, at in enumerate(moments):
        progress(k)
        drawn = unit.frame(at, rng)
        observations.append(Observation(at, solve(drawn.pixels, at), drawn.truth, drawn.pixels))
    return observations


def kept_frames(observations: Sequence[Observation], stars: StarTable, exposure_s: float) -> list[HealthFrame]:
    """Return the frames whose pixels were kept, for the rows that need pixels."""
    return [
        HealthFrame(f"frame {k + 1}", o.moment.time_s, exposure_s, partial(np.asarray, o.pixels), o.result, stars)
        for k, o in enumerate(observations)
        if o.pixels is not None
    ]


def sheet_input(
    observations: Sequence[Observation],
    camera: Camera,
    apparent: Sequence[StarTable],
    ageing: Ageing | None = None,
) -> SheetInput:
    """Return the input of the sheet. The reference is the attitude of the body, which is known in a simulation.
    ``camera``: the assumed camera; ``apparent``: apparent places of the stars of each frame, as the chain assumes
    them."""
    moments = [o.moment for o in observations]
    times = [m.time_s for m in moments]
    n = len(observations)
    true = np.array([quaternion_from_matrix(m.cam_from_icrs) for m in moments])
    ones = np.ones(n, np.intp)
    reference = AttitudeSeries(np.array(times), true, np.zeros((n, 3, 3)), ones, ones, np.zeros(n))
    results = [o.result for o in observations]
    series = series_of(times, results)
    return SheetInput(
        camera,
        series,
        star_sightings(results, camera, apparent),
        ReferenceInput(
            series,
            reference,
            pointing_blocks(series.quaternion, camera),
            np.array([0.0, 0.0, 0.0, 1.0]),
            np.array([m.temperature_c for m in moments]),
            np.array([m.velocity_c for m in moments]),
            true_reference=True,
        ),
        ageing=ageing,
    )


def staring(start: Array, count: int, camera: Camera, step_px: float, begin_s: float = 0.0) -> list[Moment]:
    """Return moments one second apart during which the image drifts by ``step_px`` per frame along both axes."""
    rate = step_px * camera.pixel_rad * np.array([1.0, -1.0, 0.0]) / np.sqrt(2)
    return [
        Moment(begin_s + k, rotation_from_vector(-rate * k) @ start, (float(rate[0]), float(rate[1]), 0.0))
        for k in range(count)
    ]


def scan(count: int, rng: np.random.Generator, begin_s: float = 0.0, step_s: float = 10.0) -> list[Moment]:
    """Return moments at random attitudes, uniformly distributed over sky and roll."""
    return [Moment(begin_s + step_s * k, matrix_from_quaternion(random_quaternion(rng))) for k in range(count)]


def slew(start: Array, count: int, top_rad_s: float, begin_s: float = 0.0, step_s: float = 1.0) -> list[Moment]:
    """Return moments of a rotation about the diagonal of the detector with a rate that oscillates between ± ``top_rad_s``."""
    axis = np.array([1.0, 1.0, 0.0]) / np.sqrt(2)
    period_s = count * step_s
    observations = []
    for k in range(count):
        phase = 2 * np.pi * k * step_s / period_s
        rate = axis * top_rad_s * np.sin(phase)
        angle = axis * top_rad_s * (1 - np.cos(phase)) * period_s / (2 * np.pi)
        observations.append(
            Moment(begin_s + k * step_s, rotation_from_vector(-angle) @ start, (float(rate[0]), float(rate[1]), 0.0))
        )
    return observations

"""Health of a sensor over a mission: figures of its frames over time, warm pixels, dark current and particle hits."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.errors import BadInput
from gss.domain.sensor import Sensor
from gss.pipeline.health.dark_course import DarkCourse, dark_course
from gss.pipeline.health.filtered import FilteredCourse, filtered_course
from gss.pipeline.health.frame_figures import (
    COUNTS,
    FIGURES,
    HealthFrame,
    count_hits,
    frame_figures,
    over_sky,
)
from gss.pipeline.health.pixel_course import PixelCourse, PixelSeries, pixel_course
from gss.pipeline.health.pixel_search import BlockMaps, block_edges, candidates
from gss.pipeline.health.trend import MAX_JUMPS, ToleranceExit, Trend, fit_trend, tolerance_exit

MIN_FRAMES = 30
WARM_SIGMAS = 3.0
"""A pixel is warm if its dark current exceeds the noise of one frame by this factor."""
FULL_FRAMES = 3
LENS_TOLERANCE_PX = 0.2
"""Displacement at the corner of the detector."""
CENTRE_TOLERANCE_PX = 5.0
FOCUS_TOLERANCE = 0.2
LIGHT_TOLERANCE_MAG = 0.3
Progress = Callable[[float, str], None]


@dataclass(frozen=True)
class FigureCourse:
    """Course of one figure over the mission: (n,) samples at Unix seconds with standard deviations. ``trend``: None
    with too few samples or samples of one time. ``reference``: value in the calibration, or the fitted value at the
    start; ``leaves``: time at which the figure leaves its tolerance, None without a tolerance; ``filtered``: None
    without a trend."""

    name: str
    unit: str
    times_s: Array
    values: Array
    sigma: Array
    temperature_c: Array
    trend: Trend | None
    reference: float
    tolerance: float | None
    leaves: ToleranceExit | None
    filtered: FilteredCourse | None = None


@dataclass(frozen=True)
class MissionHealth:
    """Health of one camera. n solved frames: ``times_s``, ``temperature_c``, ``exposure_s``, ``level_dn``,
    ``particles`` (hits in each frame), ``place_rad`` (n, 2) latitude and longitude, NaN if unknown. ``warm_e_s``:
    minimum dark current of a warm pixel at the reference temperature."""

    frames: int
    times_s: Array
    temperature_c: Array
    exposure_s: Array
    level_dn: Array
    place_rad: Array
    particles: NDArray[np.intp]
    dark: DarkCourse
    warm_e_s: float
    pixels: tuple[PixelCourse, ...]
    figures: tuple[FigureCourse, ...]

    def figure(self, name: str) -> FigureCourse:
        """Return the figure of that name."""
        return next(f for f in self.figures if f.name == name)


def mission_health(frames: Sequence[HealthFrame], camera: Camera, sensor: Sensor, progress: Progress) -> MissionHealth:
    """Compute the health of one camera from frames at any attitudes, in any order. Each frame is read twice. Raises
    BadInput with fewer than 30 solved frames, for a frame of another size, and if all have the same time."""
    solved = sorted((f for f in frames if f.solved), key=lambda f: f.time_s)
    if len(solved) < MIN_FRAMES:
        raise BadInput(
            "too few frames for the health of a sensor",
            expected=f"{MIN_FRAMES} with an attitude",
            got=f"{len(solved)} of {len(frames)}",
        )
    if solved[0].time_s == solved[-1].time_s:
        raise BadInput("all frames have the same time", expected="frames of weeks to years")
    edges = block_edges(len(solved))
    blocks = BlockMaps(edges)
    measured: list[dict[str, tuple[float, float]]] = []
    level, noise = np.empty(len(solved)), np.empty(len(solved))
    for k, frame in enumerate(solved):
        progress(0.55 * k / len(solved), f"Figures of {frame.name}, {k + 1} of {len(solved)}")
        pixels = frame.pixels()
        if pixels.shape != (camera.rows, camera.columns):
            raise BadInput(
                f"{frame.name} does not have the size of the camera",
                expected=f"{camera.columns} x {camera.rows} px",
                got=f"{pixels.shape[1]} x {pixels.shape[0]} px",
            )
        sky = over_sky(frame, pixels, sensor)
        level[k], noise[k] = sky.level_dn, sky.noise_dn
        measured.append(frame_figures(frame, pixels, sky, camera, sensor))
        blocks.add(sky.dark_dn)
    progress(0.55, "Searching for warm pixels")
    times, warm, exposure = (
        np.array([getattr(f, name) for f in solved]) for name in ("time_s", "temperature_c", "exposure_s")
    )
    dark = dark_course(times, warm, exposure, level, noise, sensor.gain_e_per_dn)
    followed = candidates(blocks.maps)
    excess, particles = _second_reading(solved, sensor, blocks.maps, edges, followed, progress)
    drive = exposure * dark.factor(warm)
    warm_e_s = WARM_SIGMAS * float(np.median(noise / drive)) * sensor.gain_e_per_dn
    courses = []
    for k, pixel in enumerate(followed):
        progress(0.85 + 0.13 * k / len(followed), f"Course of warm pixel {k + 1} of {len(followed)}")
        series = PixelSeries(times, excess[:, k].astype(float), noise, drive, sensor.gain_e_per_dn)
        row, col = divmod(int(pixel), camera.columns)
        course = pixel_course(series, col, row, warm_e_s)
        if course is not None:
            courses.append(course)
    progress(0.98, "Trends")
    return MissionHealth(
        len(frames),
        times,
        warm,
        exposure,
        level,
        np.array([(np.nan, np.nan) if f.place_rad is None else f.place_rad for f in solved]),
        particles,
        dark,
        warm_e_s,
        tuple(sorted(courses, key=lambda c: -c.now_e_s.value)),
        tuple(_figure(name, times, warm, measured, camera) for name in FIGURES),
    )


def _second_reading(
    solved: Sequence[HealthFrame],
    sensor: Sensor,
    maps: NDArray[np.float32],
    edges: list[int],
    followed: NDArray[np.intp],
    progress: Progress,
) -> tuple[NDArray[np.float32], NDArray[np.intp]]:
    """Read the frames again. Returns (n, k) values of the followed pixels, and the (n,) numbers of particle hits in
    other pixels."""
    values = np.empty((len(solved), len(followed)), np.float32)
    full = np.zeros(values.shape, bool)
    particles = np.zeros(len(solved), np.intp)
    block = np.searchsorted(edges, np.arange(len(solved)), side="right") - 1
    for k, frame in enumerate(solved):
        progress(0.58 + 0.27 * k / len(solved), f"Pixels of {frame.name}, {k + 1} of {len(solved)}")
        pixels = frame.pixels()
        sky = over_sky(frame, pixels, sensor)
        dark = sky.dark_dn.ravel()
        values[k], full[k] = dark[followed], pixels.ravel()[followed] >= sensor.saturation_dn
        dark[followed] = np.nan
        particles[k] = count_hits(dark.reshape(pixels.shape), maps[block[k]], sky.noise_dn, sensor.gain_e_per_dn)
    values[full & ~_always_full(full)] = np.nan
    return values, particles


def _always_full(full: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Return a (k,) mask, True for pixels that are saturated in most frames after their first saturation. For these
    pixels, the value is a lower limit. In other pixels, a saturated value is caused by a particle or by a frame that
    was too warm."""
    since = np.maximum.accumulate(full, axis=0).sum(axis=0)
    times = full.sum(axis=0)
    return np.asarray((times >= FULL_FRAMES) & (2 * times > since))


def _figure(
    name: str, times_s: Array, temperature_c: Array, measured: Sequence[dict[str, tuple[float, float]]], camera: Camera
) -> FigureCourse:
    frame_index = [k for k, s in enumerate(measured) if name in s]
    value = np.array([measured[k][name][0] for k in frame_index])
    sigma = np.array([measured[k][name][1] for k in frame_index])
    t, warm = times_s[frame_index], temperature_c[frame_index]
    try:
        trend = fit_trend(t, value, sigma, warm, 0 if name in COUNTS else MAX_JUMPS)
    except BadInput:
        return FigureCourse(name, FIGURES[name], t, value, sigma, warm, None, float("nan"), None, None)
    start = float(trend.at(t[:1])[0])
    reference, tolerance = _tolerance(name, camera, start)
    leaves = None if tolerance is None else tolerance_exit(trend, reference, tolerance, float(times_s[-1]))
    return FigureCourse(
        name,
        FIGURES[name],
        t,
        value,
        sigma,
        warm,
        trend,
        reference,
        tolerance,
        leaves,
        filtered_course(t, value, sigma, warm, trend),
    )


def _tolerance(name: str, camera: Camera, start: float) -> tuple[float, float | None]:
    """Return reference value and tolerance of a figure. The reference is the calibration for the lens, and the start of
    the mission for other figures."""
    half_px = float(np.hypot(camera.columns, camera.rows)) / 2
    lens = {
        "focal length": (camera.focal_col_px, LENS_TOLERANCE_PX * camera.focal_col_px / half_px),
        "centre column": (camera.centre_col_px, CENTRE_TOLERANCE_PX),
        "centre row": (camera.centre_row_px, CENTRE_TOLERANCE_PX),
        "distortion": (0.0, LENS_TOLERANCE_PX),
        "PSF width": (start, FOCUS_TOLERANCE * start),
    }
    if name.startswith("light of"):
        return start, LIGHT_TOLERANCE_MAG
    return lens.get(name, (start, None))

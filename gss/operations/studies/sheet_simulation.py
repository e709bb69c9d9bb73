"""Input of the performance sheet of a simulated unit. The chain of the unit solves rendered frames, and the results are
compared with the truth."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from gss.domain.angles import Array
from gss.domain.camera_profile import CameraProfile
from gss.domain.sensor import Defects
from gss.operations.frames.observer import Observer
from gss.operations.frames.solve import DEFAULT_EPOCH_JYEAR, Solver, SolveRequest
from gss.operations.studies.night_frames import ProgressCallback
from gss.pipeline.chip import make_chip
from gss.pipeline.readout import HotPixel
from gss.pipeline.render import FalseStar
from gss.pipeline.score import Score, assess
from gss.pipeline.sheet.ageing import ageing_of
from gss.pipeline.sheet.collect import trials_of
from gss.pipeline.sheet.sheet import SheetInput
from gss.pipeline.sheet.trials import Trials
from gss.pipeline.sheet.unit import (
    CALIBRATED_C,
    Disturbance,
    Moment,
    Observation,
    RenderedUnit,
    kept_frames,
    scan,
    sheet_input,
    slew,
    staring,
)
from gss.pipeline.veil import Veil, halo, sun_stray

SCAN_FRAMES, STARE_FRAMES, SLEW_FRAMES, EACH_FRAMES = 60, 60, 24, 100
MAX_SCAN_FRAMES, WANTED_STARS = 180, 700
SCAN_STEP_S, PAUSE_S = 100.0, 1000.0
PIXEL_FRAMES = 24
"""Number of frames whose pixels are kept for the ageing."""
STARE_PX = 0.03
SLEW_PX = 2.0
"""Smear in pixels at the maximum rate of the slew."""
MOON_MAG, MOON_RAD, MOON_POINTS = -12.7, math.radians(0.26), 40
EARTH_C, ORBIT_C, ORBIT_S = 9.94e-5, 2.5e-5, 5_700.0
"""Speeds of the Earth and of a spacecraft in a low orbit in units of c, and period of the orbit in seconds."""
SWING_K = 10.0
FAR_MARGIN_RAD = math.radians(10.0)
PROTONS = 200
AGED = (
    ("dark current x 10", 10.0, 1.0, 0.0),
    ("transmission −20 %", 1.0, 0.8, 0.0),
    ("1 % of the pixels hot", 1.0, 1.0, 0.01),
    ("all three", 10.0, 0.8, 0.01),
)
"""(title, factor of the dark current, factor of the light, share of hot pixels). These values are assumptions, not the
result of a radiation analysis."""


@dataclass(frozen=True)
class _Bench:
    """Renders and solves frames of one profile."""

    profile: CameraProfile
    solver: Solver
    chain: str

    def unit(self, light: float = 1.0, defects: Defects | None = None, seed: int = 1) -> RenderedUnit:
        """Return the simulated unit. ``light``: factor of the light; ``defects``: None for the defects of the
        profile."""
        profile = self.profile
        sensor = replace(profile.sensor, zero_point_e_s=profile.sensor.zero_point_e_s * light)
        chip = make_chip(profile.defects if defects is None else defects, sensor, profile.camera, seed)
        stars = self.solver.cache.stars(DEFAULT_EPOCH_JYEAR)
        return RenderedUnit(profile.camera, sensor, stars, profile.sensor.exposure_s, chip)

    def request(self, moment: Moment) -> SolveRequest:
        """Return the request to solve a frame without a prior attitude."""
        return SolveRequest(
            self.chain,
            camera_profile=self.profile,
            epoch_jyear=DEFAULT_EPOCH_JYEAR,
            observer=Observer(moment.velocity_c, "aberration by the known velocity was corrected"),
            exposure_s=self.profile.sensor.exposure_s,
        )


def simulated_input(
    solver: Solver, profile: CameraProfile, chain: str, seed: int, progress: ProgressCallback
) -> SheetInput:
    """Render and solve frames, and return the input of the sheet. The same seed gives the same frames."""
    bench = _Bench(profile, solver, chain)
    rng = np.random.default_rng([seed, 60])
    unit = bench.unit(seed=seed)
    conditions = disturbances(profile, np.random.default_rng([seed, 61]))
    total = SCAN_FRAMES + STARE_FRAMES + SLEW_FRAMES + EACH_FRAMES * (len(conditions) + len(AGED))
    count = itertools.count()

    def step(text: str) -> None:
        progress(min(1.0, next(count) / total), text)

    observations = _sky(bench, unit, rng, step)
    scores = [assess(o.result, o.truth, profile.camera) for o in observations]
    # The noise is measured at one pointing, so the chain must be able to solve this pointing.
    solved = [o.moment for o in observations if o.result.attitude is not None] or [o.moment for o in observations]
    start = solved[0].cam_from_icrs
    top = SLEW_PX * profile.camera.pixel_rad / profile.sensor.exposure_s
    begin_s = observations[-1].moment.time_s + PAUSE_S
    runs = (
        ("steady", staring(start, STARE_FRAMES, profile.camera, STARE_PX, begin_s)),
        ("slew", slew(start, SLEW_FRAMES, top, begin_s + STARE_FRAMES + PAUSE_S)),
    )
    for title, run in runs:
        for k, moment in enumerate(run):
            step(f"{title}, frame {k + 1} of {len(run)}")
            observations.append(_observed(bench, unit, in_orbit(moment), rng))
    return replace(
        sheet_input(
            observations,
            profile.camera,
            [unit.apparent(o.moment) for o in observations],
            ageing_of(
                kept_frames(observations, unit.stars, profile.sensor.exposure_s),
                profile.sensor,
                np.random.default_rng([seed, 66]),
            ),
        ),
        acquisition=trials_of("pointings uniform over the sky, at rest, simulated", scores),
        aged=tuple(_aged(bench, seed, step)),
        disturbed=tuple(_disturbed(bench, unit, conditions, seed, step)),
    )


def _sky(bench: _Bench, unit: RenderedUnit, rng: np.random.Generator, step: Callable[[str], None]) -> list[Observation]:
    """Observe random pointings. More pointings are observed if the chain identifies only a few stars in each."""
    observations: list[Observation] = []
    stars = 0
    while len(observations) < SCAN_FRAMES or (stars < WANTED_STARS and len(observations) < MAX_SCAN_FRAMES):
        moment = in_orbit(scan(1, rng, SCAN_STEP_S * len(observations))[0])
        step(f"Sky, frame {len(observations) + 1}")
        observations.append(_observed(bench, unit, moment, rng, keep=len(observations) < PIXEL_FRAMES))
        matches = observations[-1].result.matches
        stars += 0 if matches is None else int(np.count_nonzero(matches.weight > 0))
    return observations


def in_orbit(moment: Moment) -> Moment:
    """Return the moment with the velocity and the temperature of a spacecraft in a low orbit."""
    phase = 2 * math.pi * moment.time_s / ORBIT_S
    velocity = (EARTH_C + ORBIT_C * math.cos(phase), ORBIT_C * math.sin(phase), 0.0)
    return replace(moment, velocity_c=velocity, temperature_c=CALIBRATED_C + SWING_K * math.sin(phase))


def _observed(
    bench: _Bench, unit: RenderedUnit, moment: Moment, rng: np.random.Generator, *, keep: bool = False
) -> Observation:
    """Render and solve a frame. ``keep``: True to keep its pixels."""
    rendered = unit.frame(moment, rng)
    result = bench.solver.solve(rendered.pixels, bench.request(moment))
    return Observation(moment, result, rendered.truth, rendered.pixels if keep else None)


def _scores(
    bench: _Bench,
    unit: RenderedUnit,
    seed: int,
    step: Callable[[str], None],
    title: str,
    disturbed: Disturbance | None = None,
    dark_factor: float = 1.0,
) -> list[Score]:
    """Solve the same pointings under one condition."""
    rng = np.random.default_rng([seed, 62])
    scores = []
    for moment in map(in_orbit, scan(EACH_FRAMES, np.random.default_rng([seed, 63]))):
        step(title)
        rendered = unit.frame(moment, rng, disturbed, dark_factor)
        scores.append(
            assess(bench.solver.solve(rendered.pixels, bench.request(moment)), rendered.truth, bench.profile.camera)
        )
    return scores


def _aged(bench: _Bench, seed: int, step: Callable[[str], None]) -> Iterator[Trials]:
    for title, dark, light, hot in AGED:
        current = bench.profile.defects
        defects = replace(
            current, hot_share=current.hot_share + hot, hot_e_s=max(current.hot_e_s, 10 * _noise_e_s(bench.profile))
        )
        yield trials_of(title, _scores(bench, bench.unit(light, defects, seed), seed, step, title, None, dark))


def _noise_e_s(profile: CameraProfile) -> float:
    """Return the dark current in e⁻/s whose signal equals one standard deviation of a pixel's noise in one exposure."""
    return profile.sensor.noise_e(profile.sensor.exposure_s) / profile.sensor.exposure_s


def _disturbed(
    bench: _Bench, unit: RenderedUnit, conditions: list[Disturbance], seed: int, step: Callable[[str], None]
) -> Iterator[Trials]:
    for condition in conditions:
        yield trials_of(condition.title, _scores(bench, unit, seed, step, condition.title, condition))


def disturbances(profile: CameraProfile, rng: np.random.Generator) -> list[Disturbance]:
    """Return the disturbances for the robustness row, in detector coordinates."""
    camera, sensor = profile.camera, profile.sensor
    columns, rows = camera.columns, camera.rows
    sun = profile.baffle.sun_limit_rad
    inside_limit_rad = 0.5 * (profile.baffle.sun_limit_rad + profile.baffle.blind_rad)
    full_e_s = sensor.full_well_e / sensor.exposure_s
    hits = zip(rng.integers(0, columns, PROTONS), rng.integers(0, rows, PROTONS), rng.random(PROTONS), strict=True)
    false_star_px = rng.uniform((0, 0), (columns - 1, rows - 1), (20, 2))
    faint = rng.uniform(sensor.faint_limit_mag - 3, sensor.faint_limit_mag, 20)
    return [
        Disturbance("none"),
        Disturbance("Sun at the limit of the baffle", veil=Veil(sun_stray(camera, profile.baffle, _towards(sun)))),
        Disturbance("Sun inside the limit", veil=Veil(sun_stray(camera, profile.baffle, _towards(inside_limit_rad)))),
        _moon(profile),
        Disturbance(
            f"{PROTONS} pixels hit by protons",
            hot_pixels=tuple(HotPixel(int(c), int(r), float(full_e_s * e)) for c, r, e in hits),
        ),
        Disturbance(
            "20 false stars",
            tuple(FalseStar(c, r, float(v)) for (c, r), v in zip(false_star_px.tolist(), faint, strict=True)),
        ),
        Disturbance("one object of V −4", (FalseStar(0.4 * columns, 0.6 * rows, -4.0),)),
    ]


def _towards(angle_rad: float) -> Array:
    """Return the (3,) direction in camera axes at an angle from the boresight."""
    return np.array([math.sin(angle_rad), 0.0, math.cos(angle_rad)])


def _moon(profile: CameraProfile) -> Disturbance:
    """Return the full Moon as points on its disc at a quarter of the field, with the light that the lens scatters."""
    camera = profile.camera
    centre = np.array([0.75 * camera.columns, 0.25 * camera.rows])
    k = np.arange(MOON_POINTS) + 0.5
    radius, angle = np.sqrt(k / MOON_POINTS) * MOON_RAD / camera.pixel_rad, k * math.pi * (3 - math.sqrt(5))
    points = centre + np.column_stack([radius * np.cos(angle), radius * np.sin(angle)])
    each_mag = MOON_MAG + 2.5 * math.log10(MOON_POINTS)
    light = halo(camera, profile.sensor, camera.unproject(centre[None])[0], MOON_MAG, FAR_MARGIN_RAD)
    return Disturbance(
        "full Moon in the field", tuple(FalseStar(c, r, each_mag) for c, r in points.tolist()), veil=Veil(light)
    )

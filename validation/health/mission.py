"""Simulated year of a sensor: compare the ageing that the health analysis reports with the ageing that was rendered."""

from __future__ import annotations

import numpy as np

from gss.domain.angles import Array
from gss.domain.camera_profile import CameraProfile
from gss.domain.experiment import Cell, Curve, Experiment, Progress, share_text
from gss.domain.stars import StarTable
from gss.instruments.registry import shipped_camera
from gss.pipeline.chains import reference
from gss.pipeline.health.mission import MissionHealth, mission_health
from gss.pipeline.health.pixel_course import ANNEALING, PixelCourse
from gss.pipeline.health.trend import DAY_S, Estimate, Jump
from gss.pipeline.identify.verify import SkyCatalogue
from validation.health.year import (
    DARK_EXPONENT_K,
    DARK_PER_YEAR,
    DAYS,
    FADING_MAG_YEAR,
    FOCAL_JUMP,
    FOCAL_PER_DAY,
    FOCAL_PER_K,
    LIGHT_JUMP,
    RADIATION,
    START_S,
    WIDTH_PER_YEAR,
    ZERO_C_K,
    Year,
    year,
)

CAMERA = "cubestar"
LIMIT_MAG = 7.0
YEAR_DAYS = 365.25
RENDER_SHARE = 0.25
ANOMALY_HITS_S = 2.0
"""Rate of hits above which a position counts as inside the anomaly."""


def mission(stars: StarTable, trials: int, seed: int, progress: Progress) -> Experiment:
    """Render a year of ``trials`` frames and recover its ageing."""
    profile = shipped_camera(CAMERA)
    camera, sensor = profile.camera, profile.sensor
    deep = stars.brighter_than(LIMIT_MAG)
    sky = reference.known_sky(SkyCatalogue(deep.hip, deep.icrs, deep.v_mag), camera, sensor.faint_limit_mag)
    simulated = year(
        profile,
        deep,
        trials,
        seed,
        lambda pixels: reference.solve_known(pixels, camera, sensor, sky, exposure_s=sensor.exposure_s),
        lambda s: progress(RENDER_SHARE * s),
    )
    health = mission_health(
        simulated.frames, camera, sensor, lambda s, _: progress(RENDER_SHARE + (1 - RENDER_SHARE) * s)
    )
    progress(1.0)
    rows = [
        *_trends(health, profile),
        *_dark(health),
        *_pixels(health, simulated, profile),
        *_particles(health, simulated),
    ]
    days = (health.figure("focal length").times_s - START_S) / DAY_S
    return Experiment(
        "mission-health",
        "Health over a simulated year",
        "performance of GSS; no publication",
        ("quantity", "rendered", "found", "95 %", "inside"),
        tuple(rows),
        (
            f"{trials} frames at random attitudes and times of {DAYS:g} days of the {profile.title} in a polar orbit; "
            f"{len(health.times_s)} with an attitude",
            f"the temperature varies by ±9 K with a period of 61 days; {RADIATION.damaged_per_day:g} damaged "
            "pixels a day, half of them anneal "
            f"with half-lives of {RADIATION.half_life_days[0]:g} to {RADIATION.half_life_days[1]:g} days, a tenth grows",
            f"{RADIATION.hits_s:g} particles a second, {RADIATION.anomaly_hits_s:g} in the middle of the South Atlantic Anomaly",
            "focal length, brightness and width of the stars drift; focal length and brightness each change abruptly once",
        ),
        seed,
        (
            "A damaged pixel is detected if its dark current exceeds the minimum dark current of a warm pixel. "
            "A row states this minimum.",
            "Particles next to stars and particles with less charge than the threshold are not counted.",
            "Levels outside their interval are mostly those of annealing pixels whose decay is not significant. "
            "Such a pixel is reported as steady, with its mean level over the decay. The intervals of the other "
            "pixels are correct.",
            "Five of a hundred intervals miss the true value by chance. The trends use the same samples, so "
            "misses occur together.",
        ),
        (
            Curve(
                "Focal length",
                "day",
                "px",
                tuple(float(d) for d in days),
                tuple(float(v) for v in health.figure("focal length").values),
            ),
        ),
    )


def _row(title: str, true: float, estimate: Estimate | None, digits: int = 3) -> tuple[Cell, ...]:
    if estimate is None:
        return (title, f"{true:.{digits}g}", None, "not found", "no")
    interval = f"{estimate.low:.{digits}g} – {estimate.high:.{digits}g}"
    return (
        title,
        f"{true:.{digits}g}",
        f"{estimate.value:.{digits}g}",
        interval,
        "yes" if estimate.contains(true) else "no",
    )


def _scaled(e: Estimate, factor: float, offset: float = 0.0) -> Estimate:
    low, high = sorted((e.low * factor + offset, e.high * factor + offset))
    return Estimate(e.value * factor + offset, low, high)


def _jump(jumps: tuple[Jump, ...], day: float) -> Jump | None:
    """Return the jump nearest to a day; None if there is no jump."""
    return min(jumps, key=lambda j: abs(j.time_s.value - START_S - day * DAY_S), default=None)


def _trends(health: MissionHealth, profile: CameraProfile) -> list[tuple[Cell, ...]]:
    focal_px = profile.camera.focal_col_px
    rows: list[tuple[Cell, ...]] = []
    focal = health.figure("focal length").trend
    assert focal is not None  # noqa: S101 - a year has enough frames
    jump = _jump(focal.jumps, FOCAL_JUMP[0])
    rows += [
        _row("focal length, px/year", FOCAL_PER_DAY * focal_px * YEAR_DAYS, _scaled(focal.per_day, YEAR_DAYS)),
        _row("focal length, px/K", FOCAL_PER_K * focal_px, focal.per_k),
        _row("jump of the focal length, day", FOCAL_JUMP[0], None if jump is None else _day(jump), 5),
        _row("jump of the focal length, px", FOCAL_JUMP[1] * focal_px, None if jump is None else jump.size),
        ("jumps of the focal length", "1", str(len(focal.jumps)), None, "yes" if len(focal.jumps) == 1 else "no"),
    ]
    for name, true in FADING_MAG_YEAR.items():
        trend = health.figure(f"light of {name} stars").trend
        if trend is None:
            continue
        jump = _jump(trend.jumps, LIGHT_JUMP[0])
        rows += [
            _row(f"loss of light of {name} stars, mag/year", true, _scaled(trend.per_day, YEAR_DAYS)),
            _row(f"jump of the light of {name} stars, day", LIGHT_JUMP[0], None if jump is None else _day(jump), 5),
            _row(f"jump of the light of {name} stars, mag", LIGHT_JUMP[1], None if jump is None else jump.size),
        ]
    width = health.figure("PSF width").trend
    assert width is not None  # noqa: S101 - a year has enough frames
    sigma_px = profile.sensor.psf_sigma_px
    rows.append(_row("width of the stars, px/year", WIDTH_PER_YEAR * sigma_px, _scaled(width.per_day, YEAR_DAYS)))
    other = [
        f for f in health.figures if f.trend is not None and f.name in ("centre column", "centre row", "distortion")
    ]
    beside = [f.name for f in other if f.trend is not None and (f.trend.jumps or not f.trend.per_day.contains(0.0))]
    rows.append(("other figures that changed", "none", ", ".join(beside) or "none", None, "no" if beside else "yes"))
    return rows


def _day(jump: Jump) -> Estimate:
    return _scaled(jump.time_s, 1 / DAY_S, -START_S / DAY_S)


def _dark(health: MissionHealth) -> list[tuple[Cell, ...]]:
    dark = health.dark
    kelvin = dark.reference_c + ZERO_C_K
    middle = 1 + DARK_PER_YEAR * (health.times_s[0] + health.times_s[-1] - 2 * START_S) / (2 * DAY_S * YEAR_DAYS)
    return [
        _row("dark current doubles every, K", float(np.log(2)) * kelvin**2 / DARK_EXPONENT_K, dark.doubling_k),
        _row("growth of the dark current, 1/year", DARK_PER_YEAR / float(middle), dark.growth_per_year),
    ]


def _pixels(health: MissionHealth, simulated: Year, profile: CameraProfile) -> list[tuple[Cell, ...]]:
    columns, damage = profile.camera.columns, simulated.damage
    row_of = {int(p): k for k, p in enumerate(damage.place)}
    factor = float(health.dark.factor(20.0))
    days = (health.times_s - START_S) / DAY_S
    first = np.searchsorted(days, damage.onset_day)
    exposed = [k for k in range(len(first)) if first[k] < len(days)]
    strong = {k for k in exposed if float(damage.dark_e_s(float(days[first[k]]))[k]) / factor > health.warm_e_s}
    new = [(c, row_of.get(c.row * columns + c.col, -1)) for c in health.pixels if c.onset_s is not None]
    matched = [(c, k) for c, k in new if k >= 0]
    factory = set(simulated.chip.hot.tolist())
    false = [
        c for c in health.pixels if c.row * columns + c.col not in factory and c.row * columns + c.col not in row_of
    ]
    lives = [
        c.half_life_s.contains(float(damage.half_life_days[k]) * DAY_S)
        for c, k in matched
        if c.half_life_s is not None and np.isfinite(damage.half_life_days[k])
    ]
    detected = {k for _, k in matched}
    megapixels = profile.camera.rows * columns / 1e6
    return [
        ("smallest dark current of a warm pixel, e/s", None, f"{health.warm_e_s:.0f}", None, None),
        ("damaged pixels above it", str(len(strong)), _share([k in detected for k in sorted(strong)]), None, None),
        ("onset within its interval", "95 %", _share([_dated(c, damage.onset_day[k]) for c, k in matched]), None, None),
        (
            "dark current in the first frame, within its interval",
            "95 %",
            _share([_level(c.first_e_s, damage.dark_e_s(float(days[first[k]]))[k] / factor) for c, k in matched]),
            None,
            None,
        ),
        (
            "dark current at the end, within its interval",
            "95 %",
            _share([_level(c.now_e_s, damage.dark_e_s(float(days[-1]))[k] / factor) for c, k in matched]),
            None,
            None,
        ),
        ("half-life within its interval", "95 %", _share(lives), None, None),
        (
            "annealing pixels reported as annealing",
            None,
            _share([c.shape == ANNEALING for c, k in matched if np.isfinite(damage.half_life_days[k])]),
            None,
            None,
        ),
        (
            "false warm pixels per megapixel",
            "< 1",
            f"{len(false) / megapixels:.1f}",
            f"{len(false)} in {megapixels:.2f} Mpx",
            "yes" if len(false) < megapixels else "no",
        ),
    ]


def _dated(course: PixelCourse, day: float) -> bool:
    return course.onset_s is not None and course.onset_s.contains(START_S + day * DAY_S)


def _level(estimate: Estimate, true_e_s: float) -> bool:
    return estimate.contains(float(true_e_s))


def _share(hits: list[bool]) -> str | None:
    return share_text(sum(hits), len(hits)) if hits else None


def _particles(health: MissionHealth, simulated: Year) -> list[tuple[Cell, ...]]:
    true: Array = np.array([t.hits for f, t in zip(simulated.frames, simulated.true, strict=True) if f.solved], float)
    rate = np.array([t.rate_s for f, t in zip(simulated.frames, simulated.true, strict=True) if f.solved])
    rows: list[tuple[Cell, ...]] = []
    for title, inside in (("in the anomaly", rate > ANOMALY_HITS_S), ("elsewhere", rate <= ANOMALY_HITS_S)):
        count = int(np.count_nonzero(inside))
        if count:
            text = f"{health.particles[inside].sum() / count:.2f}"
            rows.append(
                (f"particles per frame {title}", f"{true[inside].sum() / count:.2f}", text, f"{count} frames", None)
            )
    return rows

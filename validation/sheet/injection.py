"""Injection of each error of the performance sheet into rendered frames: the row of the error recovers it, and the
other rows do not change."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import ARCSEC_RAD, Array
from gss.domain.camera import Brown, Camera
from gss.domain.experiment import Cell, Experiment, Progress
from gss.domain.results import SolveResult
from gss.domain.rotation import quaternion_from_matrix, turn_between
from gss.domain.sensor import Defects
from gss.domain.stars import StarTable
from gss.instruments.registry import shipped_camera
from gss.pipeline.ageing import Radiation
from gss.pipeline.chains import reference
from gss.pipeline.chip import make_chip
from gss.pipeline.identify.verify import SkyCatalogue
from gss.pipeline.sheet.ageing import ageing_of
from gss.pipeline.sheet.rows import SheetFigure
from gss.pipeline.sheet.sheet import PerformanceSheet, performance_sheet
from gss.pipeline.sheet.spatial import rotation_effect
from gss.pipeline.sheet.unit import (
    Moment,
    Observation,
    RenderedUnit,
    kept_frames,
    observe,
    scan,
    sheet_input,
    slew,
    staring,
)

CAMERA = Camera.from_fov(384, 288, float(np.radians(14.0)))
LIMIT_MAG = 6.0
EXPOSURE_S = 0.2
FIELD_K1 = 0.05
BIAS_RAD = (20 * ARCSEC_RAD, -20 * ARCSEC_RAD, 60 * ARCSEC_RAD)
THERMAL_RAD_K = (2 * ARCSEC_RAD, -2 * ARCSEC_RAD, 4 * ARCSEC_RAD)
DATE_S = 0.05
RESPONSE_SIGMA = 0.08
READ_NOISE = 6.0
COVERED = 10
SIZES = {"1": (1.0, ""), "share": (0.01, "%")}
"""Factor and symbol of the unit in which a figure is written."""
SPEED_C = 1e-4
TOP_RATE_RAD_S = float(np.radians(0.4))
WARM_K = 10.0
DARK_FACTOR, TRANSMISSION, HITS_PER_FRAME = 10.0, 0.8, 3.0
HIT_E = 20_000.0
"""Mean charge of a particle. It is so large that hardly any particle is below the threshold of the count."""
MAIN = (
    ("bias", "x"),
    ("thermo-elastic", "x"),
    ("field-of-view", "one star"),
    ("pixel", "one star, fixed"),
    ("temporal-noise", "x"),
    ("aberration", "remaining share"),
    ("date", "date error"),
    ("acquisition", "none"),
    ("tracking", "loss per frame"),
    ("end-of-life", "dark current"),
    ("end-of-life", "light lost"),
    ("end-of-life", "particle hits per frame"),
)
"""Rows and figures that are compared. The first figure of a row is that of its error, unless the case names another."""


@dataclass(frozen=True)
class _Case:
    """One injected error. ``row``: row that must detect it, "" for none; ``figure``: its figure, "" for the row's only
    figure. ``injected``: size in the unit of the figure,
    None if it is computed from the frames. ``covered``: one frame in this number shows no star. ``beside``: other rows
    that the error must change."""

    title: str
    row: str
    unit: RenderedUnit
    injected: float | None = None
    corrected: bool = True
    covered: int = 0
    beside: tuple[str, ...] = ()
    figure: str = ""

    @property
    def main(self) -> tuple[str, str]:
        """Row and figure that must detect the error."""
        return next(m for m in MAIN if m[0] == self.row and self.figure in ("", m[1]))


def injection(stars: StarTable, trials: int, seed: int, progress: Progress) -> Experiment:
    """Render a unit with each error, compute its sheet, and compare. ``trials``: random pointings of each unit."""
    deep = stars.brighter_than(7.0)
    sky = reference.known_sky(SkyCatalogue(deep.hip, deep.icrs, deep.v_mag), CAMERA, LIMIT_MAG)
    # Stars that have companions within their spot are excluded, because their error would contribute to every row.
    alone = stars.take(np.flatnonzero(np.isin(stars.hip, sky.sky.hip)))
    cases = _cases(alone)
    rows: list[tuple[Cell, ...]] = []
    calm: PerformanceSheet | None = None
    for k, case in enumerate(cases):
        seen = _observations(case, sky, trials, seed, lambda s, k=k: progress((k + s) / len(cases)))  # type: ignore[misc]
        ageing = ageing_of(kept_frames(seen, alone, EXPOSURE_S), cases[0].unit.sensor, np.random.default_rng([seed, 3]))
        apparent = [case.unit.apparent(o.moment) if case.corrected else alone for o in seen]
        sheet = performance_sheet(sheet_input(seen, CAMERA, apparent, ageing), np.random.default_rng([seed, 2]))
        calm = sheet if calm is None else calm
        rows.append(_row(case, sheet, calm, seen))
    progress(1.0)
    return Experiment(
        "sheet-injection",
        "Performance sheet: each error alone",
        "ECSS-E-ST-60-20C, terms of the error budget",
        ("injected error", "row that detects it", "injected", "found", "95 %", "inside", "other rows that changed"),
        tuple(rows),
        (
            f"{trials} random pointings, {trials} frames at rest and {trials} of a slew to 0.4°/s for each unit; "
            f"{CAMERA.columns} x {CAMERA.rows} px, 14° wide, 8 bits, stars to V {LIMIT_MAG} without close companions",
            f"the temperature varies by ±{WARM_K:g} K and the velocity by 30 km/s; the reference is the true attitude",
            "a row changes if its interval does not overlap that of the same unit without error",
        ),
        seed,
        (
            "The injected size of the field error is computed for the stars that the attitudes use. The injected "
            "size of the noise is the scatter of the attitude errors at rest.",
            "The chain rejects stars whose error exceeds about 0.2 px. Near the edge of the field these are the stars "
            "whose noise adds to the lens error, so the residuals of the other stars are too small. The spatial errors "
            "are therefore fitted to the rejected stars too.",
            "A lens error rotates the attitude by an angle that depends on the stars in the field, so it can also "
            "change rows that compare attitudes.",
            "Particles next to a star, and particles that leave too little charge, are not counted.",
            "A spread of the pixel response cannot be stated as a position error in pixels, so its row is only "
            "compared with the unit without error.",
        ),
    )


def _cases(stars: StarTable) -> list[_Case]:
    own = shipped_camera("cubestar").sensor
    sensor = replace(own, zero_point_e_s=6 * own.zero_point_e_s, psf_sigma_px=0.9, faint_limit_mag=LIMIT_MAG)
    unit = RenderedUnit(CAMERA, sensor, stars, EXPOSURE_S)
    bent = replace(CAMERA, distortion=Brown(k1=FIELD_K1))
    chip = make_chip(Defects(response_sigma=RESPONSE_SIGMA), sensor, CAMERA, 5)
    noisy = replace(sensor, read_noise_e=READ_NOISE * sensor.read_noise_e)
    return [
        _Case("none", "", unit),
        _Case("mounting", "bias", replace(unit, bias_rad=BIAS_RAD), BIAS_RAD[0]),
        _Case(
            "bending with temperature", "thermo-elastic", replace(unit, thermal_rad_k=THERMAL_RAD_K), THERMAL_RAD_K[0]
        ),
        _Case("lens distortion left", "field-of-view", replace(unit, camera=bent)),
        _Case("pixel response", "pixel", replace(unit, chip=chip)),
        _Case("read-out noise", "temporal-noise", replace(unit, sensor=noisy)),
        _Case("aberration not corrected", "aberration", unit, 1.0, corrected=False),
        _Case("late time stamps", "date", replace(unit, date_s=DATE_S), DATE_S),
        _Case("every tenth frame covered", "acquisition", unit, 1 / COVERED, covered=COVERED, beside=("tracking",)),
        # Nine of ten frames are solved. After one of the nine, the covered frame follows.
        _Case(
            "every tenth frame covered", "tracking", unit, 1 / (COVERED - 1), covered=COVERED, beside=("acquisition",)
        ),
        _Case(
            f"dark current x {DARK_FACTOR:g}",
            "end-of-life",
            replace(unit, sensor=replace(sensor, dark_current_e_s=DARK_FACTOR * sensor.dark_current_e_s)),
            DARK_FACTOR * sensor.dark_current_e_s,
            figure="dark current",
        ),
        _Case(
            "transmission loss",
            "end-of-life",
            replace(unit, sensor=replace(sensor, zero_point_e_s=TRANSMISSION * sensor.zero_point_e_s)),
            1 - TRANSMISSION,
            figure="light lost",
        ),
        _Case(
            "radiation hits",
            "end-of-life",
            replace(unit, radiation=Radiation(hits_s=HITS_PER_FRAME / EXPOSURE_S, hit_e=HIT_E)),
            HITS_PER_FRAME,
            figure="particle hits per frame",
        ),
    ]


def _star_error_px(bent: Camera, seen: list[Observation]) -> float:
    """Return the error per axis of the stars that the attitudes use, without their common rotation. The chain excludes
    stars with an error of more than about 0.2 px, so the error over the whole detector is larger."""
    parts = []
    for o in seen:
        if o.result.matches is not None and o.result.attitude is not None:
            used = o.result.matches.weight > 0
            measured = o.result.centroids.pixels[o.result.matches.centroid[used]]
            parts.append(measured - o.result.matches.residual_px[used])
    places = np.concatenate(parts)
    off = bent.project(CAMERA.unproject(places)) - places
    effect = rotation_effect(CAMERA, places).reshape(-1, 3)
    left = off.ravel() - effect @ np.linalg.lstsq(effect, off.ravel(), rcond=None)[0]
    return float(np.sqrt(np.mean(left**2)))


def _observations(
    case: _Case, sky: reference.KnownSky, count: int, seed: int, progress: Callable[[float], None]
) -> list[Observation]:
    rng = np.random.default_rng([seed, 1])
    moments = scan(count, rng)
    start = moments[0].cam_from_icrs
    moments += staring(start, count, CAMERA, 0.03, 1e4) + slew(start, count, TOP_RATE_RAD_S, 2e4)
    n = len(moments)
    moments = [_surrounded(m, 2 * np.pi * k / n) for k, m in enumerate(moments)]

    covered = {m.time_s for k, m in enumerate(moments) if case.covered and k % case.covered == case.covered - 1}

    def solve(pixels: NDArray[Any], at: Moment) -> SolveResult:
        if at.time_s in covered:
            pixels = np.full_like(pixels, int(np.median(pixels)))
        velocity = np.array(at.velocity_c) if case.corrected else None
        return reference.solve_known(pixels, CAMERA, case.unit.sensor, sky, velocity_c=velocity, exposure_s=EXPOSURE_S)

    return observe(case.unit, moments, solve, rng, lambda k: progress(k / n))


def _surrounded(moment: Moment, phase: float) -> Moment:
    """Add a temperature and a velocity, with different periods."""
    velocity = SPEED_C * np.array([np.cos(3 * phase), np.sin(3 * phase), 0.3])
    return replace(
        moment,
        temperature_c=20 + WARM_K * float(np.sin(5 * phase)),
        velocity_c=(float(velocity[0]), float(velocity[1]), float(velocity[2])),
    )


def _row(case: _Case, sheet: PerformanceSheet, calm: PerformanceSheet, seen: list[Observation]) -> tuple[Cell, ...]:
    moved = [
        f"{key}, {name}" if key == "end-of-life" else key
        for key, name in MAIN
        if (not case.row or (key, name) != case.main)
        and key not in case.beside
        and not _meet(_figure(sheet, key, name), _figure(calm, key, name))
    ]
    beside = ", ".join(moved) or "none"
    if not case.row:
        return (case.title, "–", None, None, None, None, beside)
    figure = _figure(sheet, *case.main)
    if figure is None:
        return (case.title, case.row, case.injected, None, "not measured", "no", beside)
    injected = case.injected
    if case.row == "temporal-noise":
        injected = _scatter_rad(seen)
    if case.row == "field-of-view":
        injected = _star_error_px(case.unit.camera, seen)
    size, unit = (ARCSEC_RAD, "″") if figure.unit.startswith("rad") else SIZES.get(figure.unit, (1.0, figure.unit))
    inside = None if injected is None else "yes" if figure.low <= injected <= figure.high else "no"
    if injected is None:
        inside = "moved" if not _meet(figure, _figure(calm, *case.main)) else "not moved"
    return (
        case.title,
        f"{case.row}, {figure.name}",
        None if injected is None else f"{injected / size:.3g} {unit}".strip(),
        f"{figure.value / size:.3g} {unit}".strip(),
        f"{figure.low / size:.3g} – {figure.high / size:.3g}",
        inside,
        beside,
    )


def _figure(sheet: PerformanceSheet, key: str, name: str) -> SheetFigure | None:
    try:
        return sheet.row(key).figure(name)
    except KeyError:
        return None


def _meet(a: SheetFigure | None, b: SheetFigure | None) -> bool:
    """True if the intervals overlap or one figure was not measured."""
    return a is None or b is None or (a.low <= b.high and b.low <= a.high)


def _scatter_rad(seen: list[Observation]) -> float:
    """Return the scatter of the attitude error about the first axis for the frames at rest, relative to the truth and
    without its slow part."""
    still = [o for o in seen if o.result.attitude is not None and 1e4 <= o.moment.time_s < 2e4]
    true: Array = np.array([quaternion_from_matrix(o.moment.cam_from_icrs) for o in still])
    got: Array = np.array([o.result.attitude.quaternion for o in still if o.result.attitude is not None])
    off = turn_between(true, got)[:, 0]
    return float(np.std(off[1:-1] - (off[:-2] + off[2:]) / 2) / np.sqrt(1.5))

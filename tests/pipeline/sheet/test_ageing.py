"""Ageing of a unit is measured from its frames: dark current, light loss and particle hits, each alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gss.catalogue_tools.sources.hipparcos import load_stars
from gss.domain.camera import Camera
from gss.domain.results import Attitude, Centroids, Outcome, SolveResult
from gss.domain.rotation import quaternion_from_matrix
from gss.instruments.registry import shipped_camera
from gss.pipeline.ageing import Radiation
from gss.pipeline.sheet.ageing import Ageing, ageing_of
from gss.pipeline.sheet.rows import SheetFigure
from gss.pipeline.sheet.trials import end_of_life_row
from gss.pipeline.sheet.unit import Observation, RenderedUnit, kept_frames, scan

CAMERA = Camera.from_fov(320, 240, float(np.radians(16.0)))
SHIPPED = shipped_camera("cubestar").sensor
SENSOR = replace(SHIPPED, zero_point_e_s=6 * SHIPPED.zero_point_e_s)
STARS = load_stars(7.0)
EXPOSURE_S = 0.2
DARK_FACTOR, TRANSMISSION, HITS = 10.0, 0.8, 3.0
UNIT = RenderedUnit(CAMERA, SENSOR, STARS, EXPOSURE_S)
UNITS = {
    "none": UNIT,
    "dark current": replace(UNIT, sensor=replace(SENSOR, dark_current_e_s=DARK_FACTOR * SENSOR.dark_current_e_s)),
    "light lost": replace(UNIT, sensor=replace(SENSOR, zero_point_e_s=TRANSMISSION * SENSOR.zero_point_e_s)),
    "particle hits per frame": replace(UNIT, radiation=Radiation(hits_s=HITS / EXPOSURE_S, hit_e=20_000.0)),
}
TRUE = {"dark current": DARK_FACTOR * SENSOR.dark_current_e_s, "light lost": 0.2, "particle hits per frame": HITS}
CALM = {"dark current": SENSOR.dark_current_e_s, "light lost": 0.0, "particle hits per frame": 0.0}


def ageing_with(unit: RenderedUnit, count: int = 12) -> Ageing | None:
    """Return the ageing of a unit, from frames whose attitude is exactly known."""
    rng = np.random.default_rng(4)
    observations = []
    for moment in scan(count, rng):
        rendered = unit.frame(moment, rng)
        attitude = Attitude(quaternion_from_matrix(moment.cam_from_icrs), np.eye(3) * 1e-10)
        nothing = Centroids.from_pixels(np.zeros((0, 2)), np.zeros(0), 0.1)
        result = SolveResult("truth", Outcome.SOLVED, "", CAMERA, (), nothing, None, attitude, float("nan"))
        observations.append(Observation(moment, result, rendered.truth, rendered.pixels))
    return ageing_of(kept_frames(observations, STARS, EXPOSURE_S), SENSOR, np.random.default_rng(5))


@pytest.mark.parametrize("injected", UNITS)
def test_each_error_is_found_in_its_figure_only(injected: str) -> None:
    """The injected size is within the interval of its figure; the other figures are those of a new unit."""
    figures: dict[str, SheetFigure] = {f.name: f for f in end_of_life_row(ageing_with(UNITS[injected]), ()).figures}
    assert set(figures) == set(TRUE)
    for name, figure in figures.items():
        true = TRUE[name] if name == injected else CALM[name]
        # Twelve intervals of 95 % are tested, so the limit is wider than half an interval.
        slack = 0.5 * (figure.high - figure.low)
        assert figure.low - slack <= true <= figure.high + slack, name


def test_few_frames_give_no_ageing() -> None:
    """With seven frames, the row states how many it needs."""
    assert ageing_with(UNIT, 7) is None
    assert "8 frames" in end_of_life_row(None, ()).needs

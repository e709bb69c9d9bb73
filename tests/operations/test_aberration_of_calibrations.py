"""Aberration in calibrations: ahead of the moving Earth the sky contracts by 1e-4, which must not change the calibration."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import partial

import numpy as np
import pytest

from gss.catalogue_tools.corrections.corrections import aberrate
from gss.catalogue_tools.envelope.orbits import jyear_of
from gss.domain.camera import Pinhole
from gss.domain.frames import cam_from_icrs
from gss.instruments.registry import shipped_camera
from gss.operations.frames.observer import epoch_at, observer_at
from gss.operations.frames.solve import Solver
from gss.operations.studies.night_frames import Shot, solve_shots
from gss.pipeline.calibration.self_calibrate import calibrate_camera
from gss.pipeline.render import render

NIGHT = datetime(2026, 3, 1, 22, tzinfo=UTC)
DOCUMENTED = shipped_camera("cubestar")
KNOWN = replace(
    DOCUMENTED,
    camera=replace(DOCUMENTED.camera, distortion=Pinhole()),
    sensor=replace(
        DOCUMENTED.sensor,
        zero_point_e_s=6 * DOCUMENTED.sensor.zero_point_e_s,
        full_well_e=60_000.0,
        bits=12,
        gain_e_per_dn=60_000.0 / 4000,
        faint_limit_mag=5.0,
    ),
)
FRAMES = 14


def shots(solver: Solver, *, corrected: bool) -> list[Shot]:
    """Return frames with aberration near the apex of the Earth's motion. They have the observer's velocity if
    ``corrected``."""
    rng, shots_made = np.random.default_rng(7), []
    observer = observer_at(NIGHT)
    velocity_c = np.array(observer.velocity_c)
    x, y, z = velocity_c / np.linalg.norm(velocity_c)
    ra, dec = float(np.arctan2(y, x)), float(np.arcsin(z))
    for k in range(FRAMES):
        taken = NIGHT + timedelta(seconds=10 * k)
        attitude = cam_from_icrs(
            ra + float(rng.uniform(-0.3, 0.3)), dec + float(rng.uniform(-0.3, 0.3)), float(rng.uniform(0, 6.28))
        )
        shot = Shot(f"{k}", taken, 0.25, 12, lambda: None, observer=observer if corrected else None)
        table = solver.cache.stars(epoch_at(shot.taken)).brighter_than(6.5)
        apparent_table = replace(table, icrs=aberrate(table.icrs, velocity_c))
        pixels = render(apparent_table, KNOWN.camera, KNOWN.sensor, attitude, 0.25, rng).pixels
        shots_made.append(replace(shot, pixels=partial(np.asarray, pixels)))
    assert jyear_of(NIGHT) == pytest.approx(2026.16, abs=0.01)
    return shots_made


def focal_error(*, corrected: bool) -> float:
    """Return the relative error of the calibrated focal length."""
    solver = Solver(shipped_camera)
    solved = solve_shots(solver, shots(solver, corrected=corrected), KNOWN, None, lambda share, text: None)
    calibration = calibrate_camera(solved.stars, KNOWN.camera, models=("pinhole",), focal_mm=KNOWN.focal_mm, folds=2)
    true_focal_px = float(np.sqrt(KNOWN.camera.focal_col_px * KNOWN.camera.focal_row_px))
    return calibration.parameter("focal_px").value / true_focal_px - 1


def test_the_focal_length_is_right_with_a_known_observer_and_biased_without() -> None:
    """The focal length is within 0.005 % with the observer's velocity, and 0.01 % (about v/c) too short without it."""
    assert abs(focal_error(corrected=True)) < 5e-5
    assert focal_error(corrected=False) == pytest.approx(-1e-4, abs=4e-5)

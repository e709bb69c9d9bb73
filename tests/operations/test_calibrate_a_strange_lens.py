"""Calibration of a lens that differs from its document by more than a calibrated camera tolerates."""

from __future__ import annotations

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from functools import partial

import numpy as np
import pytest

from gss.domain.camera import Brown, Camera
from gss.domain.frames import cam_from_icrs
from gss.instruments.registry import shipped_camera
from gss.operations.frames.solve import Solver, SolveRequest
from gss.operations.frames.solver_cache import SolverCache
from gss.operations.studies.calibrate import from_stars
from gss.operations.studies.night_frames import Shot
from gss.pipeline.render import render

KNOWN = shipped_camera("cubestar")


def lens(scale: float) -> Camera:
    """Return a camera with this focal length relative to the document, another centre and another distortion."""
    return replace(
        KNOWN.camera,
        focal_col_px=scale * KNOWN.camera.focal_col_px,
        focal_row_px=scale * KNOWN.camera.focal_row_px,
        centre_col_px=KNOWN.camera.centre_col_px + 6,
        distortion=Brown(-0.30, 0.11, 0.004, -0.006),
    )


@pytest.mark.parametrize(("scale", "is_solved"), [(1.02, True), (1.05, False)])
def test_frames_of_another_lens_calibrate_the_camera(scale: float, is_solved: bool) -> None:
    """Frames of a lens that differs by 2 % are solved with a note, and by 5 % not at all. Both calibrate the camera: the
    focal length is right within 0.1 %, and the difference is reported."""
    real = lens(scale)
    rng, cache = np.random.default_rng(2), SolverCache()
    stars, solver = cache.stars(2026.5).brighter_than(6.5), Solver(shipped_camera, cache)
    shots = []
    for k in range(5):
        attitude = cam_from_icrs(float(rng.uniform(0, 6.28)), float(rng.uniform(-1, 1)), float(rng.uniform(0, 6.28)))
        pixels = render(stars, real, KNOWN.sensor, attitude, 0.25, rng).pixels
        taken = datetime(2026, 7, 1, tzinfo=UTC) + timedelta(seconds=10 * k)
        shots.append(Shot(f"{k}", taken, 0.25, 8, partial(np.asarray, pixels)))
    result = solver.solve(shots[0].pixels(), SolveRequest(camera_profile=KNOWN))
    assert (result.attitude is not None) == is_solved
    assert any("solved with a fitted lens" in note for note in result.notes) == is_solved
    calibration = from_stars(
        solver, shots, KNOWN, lambda share, text: None, models=("brown-4",), photometry=False, psf=False
    )
    assert calibration.values["focal_col_px"] == pytest.approx(real.focal_col_px, rel=1e-3)
    assert calibration.result["geometry"]["residuals"]["rms_px"] < 0.3
    assert "plate-scale" in {w["code"] for w in calibration.result["warnings"]}

"""Calibration of real cameras from real frames, compared with independent solutions of the same frames."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from gss.domain.camera import Camera
from gss.domain.rotation import matrix_from_quaternion
from gss.instruments.registry import shipped_camera
from gss.operations.frames.frame_files import read_frame
from gss.operations.frames.solve import Solver, SolveRequest
from gss.pipeline.calibration.self_calibrate import calibrate_camera
from gss.pipeline.calibration.sightings import frame_stars

pytestmark = pytest.mark.photographs


def test_a_real_camera_is_calibrated_from_three_frames(photographs: Path) -> None:
    """One lens is calibrated from three frames of ESA's test camera. Its residuals are about 0.1 px, also for held-out
    frames, less than half of a pinhole's, and scale and pointing agree with the independent reference."""
    images = json.loads((photographs / "truth.json").read_text())["images"]
    names = sorted(n for n in images if n.startswith("esa_tetra3"))
    solver, frames = Solver(shipped_camera), []
    for name in names:
        result = solver.solve(read_frame((photographs / name).read_bytes(), name).pixels, SolveRequest(blind=True))
        frame = frame_stars(name, result, solver.cache.stars(2000.0))
        assert frame is not None
        frames.append(frame)
    first = frames[0]
    start = Camera.from_fov(first.columns, first.rows, float(np.radians(images[names[0]]["fov_h_deg"])))
    calibration = calibrate_camera(frames, start)
    assert calibration.residuals.noise_px < 0.12
    assert calibration.residuals.rejected < 0.1 * calibration.residuals.stars
    assert calibration.before.rms_px > 2 * calibration.residuals.rms_px
    assert calibration.held_out is not None
    assert calibration.held_out.rms_px < 1.15 * calibration.residuals.noise_px
    assert calibration.model != "pinhole"
    for fit in calibration.frames:
        image = images[fit.name]
        focal_px = first.columns / 2 / np.tan(np.radians(image["fov_h_deg"] / 2))
        assert calibration.parameter("focal_px").value == pytest.approx(focal_px, rel=5e-4)
        middle = calibration.camera.unproject(np.array([[(first.columns - 1) / 2, (first.rows - 1) / 2]]))[0]
        boresight = middle @ matrix_from_quaternion(fit.quaternion)
        assert np.degrees(np.linalg.norm(boresight - np.array(image["R_icrs_to_cam"])[2])) * 3600 < 20

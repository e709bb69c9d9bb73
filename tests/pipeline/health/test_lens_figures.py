"""Focal length and distortion of a frame whose lens has changed since its calibration."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gss.domain.camera import Camera
from gss.domain.results import Attitude, Centroids, Matches, Outcome, SolveResult
from gss.domain.stars import StarTable
from gss.pipeline.health.frame_figures import HealthFrame, lens_figures

CAMERA = Camera.from_fov(1024, 512, float(np.radians(49.0)))
SHRINKS = 6e-4
LIMIT_PX, NOISE_PX = 0.2, 0.08


def test_a_change_of_the_focal_length_is_not_a_distortion() -> None:
    """A chain that rejects residuals above a limit rejects stars near the edge whose noise adds to the change of the lens.
    The focal length is found, and no distortion appears, because the rejected stars are used too. The figures are the same if the
    chain has fitted the lens."""
    rng = np.random.default_rng(6)
    grid = np.stack(np.meshgrid(np.arange(30, 1000, 30.0), np.arange(20, 500, 30.0)), axis=2).reshape(-1, 2)
    true = replace(
        CAMERA, focal_col_px=CAMERA.focal_col_px * (1 - SHRINKS), focal_row_px=CAMERA.focal_row_px * (1 - SHRINKS)
    )
    count = len(grid)
    hip = np.arange(1, count + 1, dtype=np.int32)
    zero = np.zeros(count)
    still, flags = np.zeros((count, 3)), np.zeros(count, np.uint16)
    stars = StarTable(hip, CAMERA.unproject(grid), zero + 4.0, zero + 0.5, still, zero, flags, 2000.0)
    measured = true.project(stars.icrs) + NOISE_PX * rng.normal(size=grid.shape)
    residual = measured - grid
    accepted = np.flatnonzero(np.linalg.norm(residual, axis=1) < LIMIT_PX).astype(np.int32)
    assert 0.5 * count < len(accepted) < 0.95 * count
    ones = np.ones(count)
    result = SolveResult(
        "reference",
        Outcome.SOLVED,
        "",
        CAMERA,
        (),
        Centroids(measured[:, 0], measured[:, 1], ones, ones, np.full(count, 9, np.int32), NOISE_PX * ones),
        Matches(accepted, hip[accepted], np.ones(len(accepted)), residual[accepted]),
        Attitude(np.array([0.0, 0.0, 0.0, 1.0]), np.eye(3) * 1e-12),
        0.0,
    )
    frame = HealthFrame("frame", 0.0, 0.1, lambda: np.zeros((512, 1024), np.uint8), result, stars)
    figures = lens_figures(frame, result, CAMERA)
    focal, focal_sigma = figures["focal length"]
    assert focal == pytest.approx(true.focal_col_px, abs=3 * focal_sigma)
    distortion, sigma = figures["distortion"]
    assert abs(distortion) < 3 * sigma
    none = np.zeros(0, np.intp)
    about_fit = (measured - true.project(stars.icrs))[accepted]
    matches = Matches(accepted, hip[accepted], np.ones(len(accepted)), about_fit)
    again, focal_sigma = lens_figures(frame, replace(result, camera=true, matches=matches), CAMERA)["focal length"]
    assert again == pytest.approx(true.focal_col_px, abs=3 * focal_sigma)
    truncated, sigma = lens_figures(replace(frame, stars=stars.take(none)), result, CAMERA)["distortion"]
    assert abs(truncated) > 3 * sigma

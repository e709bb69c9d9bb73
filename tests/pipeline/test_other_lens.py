"""Frames of a known camera whose lens differs from its calibration."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from gss.domain.camera import Camera
from gss.domain.results import Centroids, Outcome, SolveResult
from gss.domain.rotation import rotation_from_vector
from gss.instruments.registry import shipped_camera
from gss.operations.frames.solver_cache import SolverCache
from gss.pipeline.chains import reference

JYEAR = 2026.5
SIGMA_PX = 0.2
PROFILE = shipped_camera("cubestar")
CAMERA = PROFILE.camera


@pytest.fixture(scope="module")
def sky() -> reference.KnownSky:
    """Return stars and pair table of the CubeStar camera."""
    return SolverCache().known(CAMERA, PROFILE.sensor.faint_limit_mag, JYEAR)


def star_list(
    sky: reference.KnownSky,
    camera: Camera,
    cam_from_icrs: np.ndarray,
    rng: np.random.Generator,
    false_stars: int,
    sigma_px: float,
) -> Centroids:
    """Return centroids of the stars that ``camera`` images, with errors, and of false stars."""
    vectors = sky.sky.icrs @ cam_from_icrs.T
    visible = np.flatnonzero(vectors[:, 2] > np.cos(camera.half_diagonal_rad))
    pixels = camera.project(vectors[visible])
    visible, pixels = visible[camera.contains(pixels)], pixels[camera.contains(pixels)]
    pixels = pixels + rng.normal(0, sigma_px, pixels.shape)
    false_pixels = rng.uniform([0, 0], [camera.columns, camera.rows], (false_stars, 2))
    magnitude = np.concatenate([sky.sky.v_mag[visible], rng.uniform(1, 3.8, false_stars)])
    order = np.argsort(magnitude)
    return Centroids.from_pixels(
        np.concatenate([pixels, false_pixels])[order], 10 ** (-0.4 * magnitude[order]), sigma_px
    )


def solve(
    sky: reference.KnownSky, camera: Camera, seed: int, sigma_px: float = SIGMA_PX
) -> tuple[SolveResult, np.ndarray]:
    """Solve a list of ``camera`` with the calibrated camera. Return the result and the true attitude."""
    rng = np.random.default_rng(seed)
    cam_from_icrs = rotation_from_vector(rng.normal(size=3))
    centroids = star_list(sky, camera, cam_from_icrs, rng, 3, sigma_px)
    return reference.solve_centroids(centroids, CAMERA, sky), cam_from_icrs


@pytest.mark.parametrize("scale", [0.97, 0.995, 1.01, 1.03])
def test_another_focal_length_is_measured(sky: reference.KnownSky, scale: float) -> None:
    """Lists of a lens with another focal length are solved. The result contains the focal length, and its notes state the
    difference.
    """
    for seed in range(4):
        result, truth = solve(sky, CAMERA.with_focal_scaled(scale), seed)
        assert result.outcome is Outcome.SOLVED, result.reason
        assert result.camera.focal_col_px / CAMERA.focal_col_px == pytest.approx(scale, abs=2e-3)
        assert np.degrees(np.arccos(min(1.0, result.attitude.cam_from_icrs[2] @ truth[2]))) < 0.3
        assert any("solved with a fitted lens: focal length" in note for note in result.notes)


def test_a_displaced_optical_centre_is_measured(sky: reference.KnownSky) -> None:
    """The optical centre of a wide lens is measured together with its focal length if the stars require it. Few stars
    give a value between the calibrated and the true centre."""
    lens = CAMERA.with_focal_scaled(1.02)
    lens = replace(lens, centre_col_px=lens.centre_col_px + 14, centre_row_px=lens.centre_row_px - 14)
    results = [solve(sky, lens, seed, 0.05)[0] for seed in range(6)]
    assert all(result.outcome is Outcome.SOLVED for result in results)
    measured = [result.camera for result in results if "optical centre" in result.notes[-1]]
    assert measured
    for camera in measured:
        assert 4 < camera.centre_col_px - CAMERA.centre_col_px < 24
        assert -24 < camera.centre_row_px - CAMERA.centre_row_px < -4


def test_the_calibrated_lens_has_no_note(sky: reference.KnownSky) -> None:
    """A list of the calibrated lens keeps the calibration."""
    result, _ = solve(sky, CAMERA, 1)
    assert (result.camera, result.notes) == (CAMERA, ())


def test_random_spots_are_not_solved_with_any_lens(sky: reference.KnownSky) -> None:
    """Twenty random spots give no solution, whatever the focal length, and the reason is stated."""
    rng = np.random.default_rng(5)
    for _ in range(6):
        pixels = rng.uniform([0, 0], [CAMERA.columns, CAMERA.rows], (20, 2))
        centroids = Centroids.from_pixels(pixels, np.sort(rng.uniform(10, 1000, 20))[::-1], SIGMA_PX)
        result = reference.solve_centroids(centroids, CAMERA, sky)
        assert (result.outcome, result.attitude) == (Outcome.NONE, None)
        assert result.reason

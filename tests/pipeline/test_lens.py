"""Lens coefficients are fitted only if the stars determine them."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gss.domain.angles import Array
from gss.domain.camera import Brown, Camera
from gss.pipeline.lens import fit_lens

NOISE_PX = 0.15


def field(fov_deg: float, stars: int, lens: Brown, rng: np.random.Generator) -> tuple[Array, Array, Camera, Array]:
    """Return noisy pixels, ICRS directions, the camera without distortion, and the attitude."""
    perfect = Camera.from_fov(1000, 800, np.radians(fov_deg))
    camera = Camera(1000, 800, perfect.focal_col_px, perfect.focal_row_px, 499.5, 399.5, lens)
    pixels = rng.uniform(0, [999, 799], (stars, 2))
    attitude = Rotation.random(rng=rng).as_matrix()
    icrs = camera.unproject(pixels) @ attitude
    start = Camera(1000, 800, perfect.focal_col_px, perfect.focal_row_px, 499.5, 399.5, Brown())
    return pixels + rng.normal(0, NOISE_PX, pixels.shape), icrs, start, attitude


@pytest.mark.parametrize(("fov_deg", "stars"), [(6.0, 8), (10.0, 20), (30.0, 60)])
def test_distortion_is_not_fitted_to_noise(fov_deg: float, stars: int) -> None:
    """Of forty frames of a lens without distortion, at most two get distortion coefficients, and the attitude errors
    agree with their covariance.
    """
    rng = np.random.default_rng(51)
    distorted, squared_errors = 0, []
    for _ in range(40):
        pixels, icrs, camera, attitude = field(fov_deg, stars, Brown(), rng)
        fit = fit_lens(pixels, icrs, np.full(stars, NOISE_PX), camera, attitude)
        distorted += fit.camera.distortion != Brown()
        error = Rotation.from_matrix(fit.cam_from_icrs @ attitude.T).as_rotvec()
        squared_errors.append(error @ np.linalg.solve(fit.covariance_rad2, error))
    assert distorted <= 2
    assert 2.0 < np.mean(squared_errors) < 4.5


@pytest.mark.parametrize(("fov_deg", "k1"), [(11.0, -0.5), (30.0, -0.2)])
def test_real_distortion_is_found(fov_deg: float, k1: float) -> None:
    """A radial distortion that sixty stars determine is fitted within a quarter of its size."""
    pixels, icrs, camera, attitude = field(fov_deg, 60, Brown(k1=k1), np.random.default_rng(52))
    lens = fit_lens(pixels, icrs, np.full(60, NOISE_PX), camera, attitude).camera.distortion
    assert isinstance(lens, Brown)
    assert abs(lens.k1 / k1 - 1) < 0.25


def test_all_coefficients_of_a_decentred_lens_are_fitted() -> None:
    """In a wide field with tangential distortion, all four coefficients are fitted, and the residuals are those of the
    centroids.
    """
    lens = Brown(k1=-0.32, k2=0.12, p1=0.004, p2=-0.006)
    pixels, icrs, camera, attitude = field(45.0, 120, lens, np.random.default_rng(53))
    fit = fit_lens(pixels, icrs, np.full(120, NOISE_PX), camera, attitude)
    assert set(fit.parameters) >= {"k1", "k2", "p1", "p2"}
    assert fit.rms_px < 1.15 * NOISE_PX

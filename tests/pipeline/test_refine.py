"""Least-squares fit of attitude and camera geometry."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gss.domain.angles import Array
from gss.domain.camera import Brown, Camera
from gss.domain.rotation import rotation_from_vector
from gss.pipeline.refine import refine

CAMERA = Camera(1000, 800, 2000.0, 2000.0, 499.5, 399.5, Brown(k1=-0.2))


def stars(n: int, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Return (n, 3) ICRS directions, (n, 2) exact pixels and the attitude."""
    pixels = rng.uniform(0, [999, 799], (n, 2))
    attitude = Rotation.random(rng=rng).as_matrix()
    return CAMERA.unproject(pixels) @ attitude, pixels, attitude


def test_exact_pixels_give_exact_geometry() -> None:
    """Without noise, attitude and focal length are recovered within rounding errors although the initial focal length
    is wrong by one per cent.
    """
    rng = np.random.default_rng(1)
    icrs, pixels, attitude = stars(30, rng)
    start = rotation_from_vector(np.array([0.002, -0.003, 0.01])) @ attitude
    fit = refine(pixels, icrs, np.full(30, 0.1), CAMERA.with_focal_scaled(1.01), start, fit_focal=True)
    assert np.abs(fit.cam_from_icrs - attitude).max() < 1e-9
    assert abs(fit.camera.focal_col_px - 2000) < 1e-5
    assert fit.rms_px < 1e-6


def test_covariance_agrees_with_the_errors() -> None:
    """Over two hundred noisy fits, the squared normalised attitude error has the mean of χ² with three degrees of
    freedom.
    """
    rng = np.random.default_rng(2)
    squared_errors = []
    for _ in range(200):
        icrs, pixels, attitude = stars(12, rng)
        noisy = pixels + rng.normal(0, 0.3, pixels.shape)
        fit = refine(noisy, icrs, np.full(12, 0.3), CAMERA, attitude)
        error = Rotation.from_matrix(fit.cam_from_icrs @ attitude.T).as_rotvec()
        squared_errors.append(error @ np.linalg.solve(fit.covariance_rad2, error))
    assert 2.2 < np.mean(squared_errors) < 3.4


def test_one_false_match_has_weight_zero() -> None:
    """A star twenty pixels from its position gets weight 0 and does not change the attitude."""
    rng = np.random.default_rng(3)
    icrs, pixels, attitude = stars(15, rng)
    noisy = pixels + rng.normal(0, 0.1, pixels.shape)
    noisy[4] += [15, -13]
    fit = refine(noisy, icrs, np.full(15, 0.1), CAMERA, attitude)
    assert fit.weight[4] == 0
    assert (fit.weight[np.arange(15) != 4] > 0).all()
    assert np.linalg.norm(Rotation.from_matrix(fit.cam_from_icrs @ attitude.T).as_rotvec()[:2]) < 0.2 * CAMERA.pixel_rad


@pytest.mark.parametrize(("n", "tolerance"), [(60, 0.02), (5, 0.25)])
def test_k1_is_fitted_with_enough_stars(n: int, tolerance: float) -> None:
    """Sixty stars determine the radial coefficient within 0.02. With five stars, the prior keeps it within 0.25."""
    rng = np.random.default_rng(4)
    icrs, pixels, attitude = stars(n, rng)
    noisy = pixels + rng.normal(0, 0.1, pixels.shape)
    start = Camera(1000, 800, 2000.0, 2000.0, 499.5, 399.5, Brown())
    fit = refine(noisy, icrs, np.full(n, 0.1), start, attitude, fit_focal=True, fit_lens=("k1",))
    assert isinstance(fit.camera.distortion, Brown)
    assert abs(fit.camera.distortion.k1 + 0.2) < tolerance

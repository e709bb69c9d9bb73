"""Least squares on attitude and geometry."""

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
    """(n, 3) ICRS, (n, 2) exact pixels, attitude."""
    pixels = rng.uniform(0, [999, 799], (n, 2))
    r = Rotation.random(rng=rng).as_matrix()
    return CAMERA.unproject(pixels) @ r, pixels, r


def test_exact_pixels_give_exact_geometry() -> None:
    """Without noise attitude and focal length come back to rounding from a start one per cent off."""
    rng = np.random.default_rng(1)
    icrs, pixels, r = stars(30, rng)
    start = rotation_from_vector(np.array([0.002, -0.003, 0.01])) @ r
    fit = refine(pixels, icrs, np.full(30, 0.1), CAMERA.with_focal_scaled(1.01), start, fit_focal=True)
    assert np.abs(fit.cam_from_icrs - r).max() < 1e-9
    assert abs(fit.camera.focal_col_px - 2000) < 1e-5
    assert fit.rms_px < 1e-6


def test_covariance_is_that_of_the_errors() -> None:
    """Over two hundred noisy fits the attitude error divided by its covariance has the size of three normal numbers."""
    rng = np.random.default_rng(2)
    quadratic = []
    for _ in range(200):
        icrs, pixels, r = stars(12, rng)
        noisy = pixels + rng.normal(0, 0.3, pixels.shape)
        fit = refine(noisy, icrs, np.full(12, 0.3), CAMERA, r)
        error = Rotation.from_matrix(fit.cam_from_icrs @ r.T).as_rotvec()
        quadratic.append(error @ np.linalg.solve(fit.covariance_rad2, error))
    assert 2.2 < np.mean(quadratic) < 3.4


def test_one_false_match_weighs_nothing() -> None:
    """A star twenty pixels from its place is left out with weight 0 and does not move the attitude."""
    rng = np.random.default_rng(3)
    icrs, pixels, r = stars(15, rng)
    noisy = pixels + rng.normal(0, 0.1, pixels.shape)
    noisy[4] += [15, -13]
    fit = refine(noisy, icrs, np.full(15, 0.1), CAMERA, r)
    assert fit.weight[4] == 0
    assert (fit.weight[np.arange(15) != 4] > 0).all()
    assert np.linalg.norm(Rotation.from_matrix(fit.cam_from_icrs @ r.T).as_rotvec()[:2]) < 0.2 * CAMERA.pixel_rad


@pytest.mark.parametrize(("n", "tolerance"), [(60, 0.02), (5, 0.25)])
def test_k1_is_fitted_with_enough_stars(n: int, tolerance: float) -> None:
    """Many stars give the radial coefficient; few leave it near zero, held by the prior."""
    rng = np.random.default_rng(4)
    icrs, pixels, r = stars(n, rng)
    noisy = pixels + rng.normal(0, 0.1, pixels.shape)
    start = Camera(1000, 800, 2000.0, 2000.0, 499.5, 399.5, Brown())
    fit = refine(noisy, icrs, np.full(n, 0.1), start, r, fit_focal=True, fit_lens=("k1",))
    assert isinstance(fit.camera.distortion, Brown)
    assert abs(fit.camera.distortion.k1 + 0.2) < tolerance

"""Least-squares fit of attitude and camera geometry."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gss.domain.angles import Array
from gss.domain.camera import Brown, Camera
from gss.domain.rotation import rotation_from_vector
from gss.pipeline.chains import proof
from gss.pipeline.loops.fit import fit_attitude
from gss.pipeline.loops.geometry import camera_numbers
from gss.pipeline.refine import _moved, linearised, refine

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


def displaced_far_star() -> tuple[Array, Array, Array]:
    """Return ICRS directions, pixels and attitude of four stars within 80 px and a fifth, 500 px away, that is displaced by
    4 px across the line to the others, so that it determines the roll angle.
    """
    true_px = np.array([[200.0, 200], [260, 210], [215, 270], [275, 255], [690, 420]])
    attitude = Rotation.from_rotvec([0.3, -0.8, 0.5]).as_matrix()
    noise = np.random.default_rng(6).normal(0, 0.1, (5, 2))
    noise[4] = [-1.6, 3.7]
    return CAMERA.unproject(true_px) @ attitude, true_px + noise, attitude


def compiled_fit(pixels: Array, icrs: Array, attitude: Array) -> tuple[Array, Array, Array, float]:
    """Return weights, attitude, covariance and rms of the compiled fit with errors of 0.1 px."""
    n, turn = len(pixels), attitude.copy()
    residual, weight, covariance = np.empty((n, 2)), np.empty(n), np.empty((3, 3))
    rms = fit_attitude(camera_numbers(CAMERA), pixels, icrs, np.full(n, 0.1), turn, residual, weight, covariance)
    return weight, turn, covariance, rms


def test_a_displaced_star_that_determines_the_roll_has_weight_zero() -> None:
    """The star is excluded although its residual is as small as those of the others. With four stars, none is excluded."""
    icrs, pixels, attitude = displaced_far_star()
    fit = refine(pixels, icrs, np.full(5, 0.1), CAMERA, attitude)
    assert fit.weight[4] == 0
    assert (fit.weight[:4] > 0).all()
    four = refine(pixels[1:], icrs[1:], np.full(4, 0.1), CAMERA, attitude)
    assert (four.weight > 0).all()


@pytest.mark.parametrize("displaced", [0, 1, 2])
def test_the_compiled_fit_excludes_the_same_stars(displaced: int) -> None:
    """Weights, attitude, covariance and rms are equal, with four to twelve stars of which up to two are displaced."""
    rng, excluded = np.random.default_rng(8), 0
    for n in (4, 5, 6, 8, 12):
        for _ in range(4):
            icrs, pixels, attitude = stars(n, rng)
            pixels += rng.normal(0, 0.1, pixels.shape)
            pixels[:displaced] += rng.choice([-3.0, 3.0], (displaced, 2))
            fit = refine(pixels, icrs, np.full(n, 0.1), CAMERA, attitude)
            weight, turn, covariance, rms = compiled_fit(pixels, icrs, attitude)
            assert weight == pytest.approx(fit.weight)
            assert turn == pytest.approx(fit.cam_from_icrs, abs=1e-9)
            assert covariance == pytest.approx(fit.covariance, rel=1e-5)
            assert rms == pytest.approx(fit.rms_px, rel=1e-5)
            excluded += int((fit.weight == 0).sum())
    assert (excluded >= 12) == (displaced > 0)


@pytest.mark.parametrize(
    ("moved_px", "count", "rejected"),
    [((0.0, 0.0), 8, False), ((1.0, 1.2), 8, False), ((2.5, 2.0), 8, True), ((2.5, 2.0), 4, False)],
)
def test_a_chain_rejects_an_attitude_with_a_star_displaced_by_more_than_two_pixels(
    moved_px: tuple[float, float], count: int, rejected: bool
) -> None:
    """With four stars no star can be tested. A more precise star that is displaced by less does not prevent the test of
    another one.
    """
    rng = np.random.default_rng(9)
    icrs, pixels, attitude = stars(count, rng)
    pixels += rng.normal(0, 0.1, pixels.shape)
    pixels[2] += moved_px
    sigma_px = np.full(count, 0.1)
    assert bool(proof.displaced(CAMERA.unproject(pixels), sigma_px, icrs, CAMERA, attitude)) == rejected
    sigma_px[0] = 0.05
    pixels[0] += [0.0, 1.0]
    assert bool(proof.displaced(CAMERA.unproject(pixels), sigma_px, icrs, CAMERA, attitude)) == rejected


def test_normal_errors_rarely_exclude_a_star() -> None:
    """Of a thousand fits to eight stars with normal errors, whose stated errors are too small by a third, at most five lose a
    star; 1 is expected.
    """
    rng = np.random.default_rng(7)
    lost = 0
    for _ in range(1000):
        icrs, pixels, attitude = stars(8, rng)
        fit = refine(pixels + rng.normal(0, 0.3, pixels.shape), icrs, np.full(8, 0.2), CAMERA, attitude)
        lost += int((fit.weight == 0).any())
    assert lost <= 5


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


@pytest.mark.parametrize("name", ["focal", "aspect", "k1", "k2", "p1", "p2", "col", "row"])
def test_derivatives_agree_with_differences(name: str) -> None:
    """The derivative with respect to each camera parameter agrees with the difference of two predictions after half a step
    in each direction.
    """
    lens = Brown(k1=-0.2, k2=0.05, p1=0.001, p2=-0.002)
    camera = Camera(1000, 800, 900.0, 930.0, 510.0, 380.0, lens)
    pixels = np.random.default_rng(4).uniform(0, [999, 799], (40, 2))
    icrs, names, step = camera.unproject(pixels), ["x", "y", "z", name], 1e-4
    _, jacobian = linearised(pixels, icrs, camera, np.eye(3), names)
    before, after = (
        moved.project(icrs)
        for moved, _ in (_moved(camera, np.eye(3), np.array([0, 0, 0, s / 2]), names) for s in (-step, step))
    )
    assert np.abs(jacobian[..., 3]).max() > 1
    np.testing.assert_allclose(jacobian[..., 3], (after - before) / step, rtol=0, atol=1e-4)

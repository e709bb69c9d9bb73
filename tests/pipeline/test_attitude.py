"""Attitude solvers and covariances, compared with scipy's Rotation and with the scatter of noisy solutions."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.domain.rotation import matrix_from_quaternion, random_quaternion, rotation_angle_rad
from gss.pipeline import attitude


def _scene(rng: np.random.Generator, n: int, spread: float, sigma_rad: float, quaternion: Array) -> tuple[Array, Array]:
    """Return ``n`` directions within about ``spread`` rad of the boresight, measured with noise, and their ICRS
    references.
    """
    true = np.column_stack([rng.uniform(-spread, spread, (n, 2)), np.ones(n)])
    true /= np.linalg.norm(true, axis=1, keepdims=True)
    measured = true + sigma_rad * rng.normal(size=(n, 3))
    measured /= np.linalg.norm(measured, axis=1, keepdims=True)
    return measured, true @ matrix_from_quaternion(quaternion)


def _as_matrix(name: str, b: Array, r: Array, w: Array) -> Array:
    """Return the attitude matrix from the solver ``name``, which may return a quaternion."""
    estimate = getattr(attitude, name)(b, r, w)
    return matrix_from_quaternion(estimate) if estimate.shape == (4,) else estimate


def _condition(b: Array, w: Array) -> float:
    """Return the largest variance of the attitude for unit total information. Rounding errors are amplified by this
    factor.
    """
    return float(np.linalg.eigvalsh(attitude.covariance_rad2(b, np.sqrt(w.sum() / w)))[-1])


@pytest.mark.parametrize("name", ["quest", "q_method", "svd", "foam"])
@pytest.mark.parametrize("n", [2, 3, 12])
def test_optimal_solvers_agree_with_scipy(name: str, n: int) -> None:
    """Every optimal solver agrees with scipy's align_vectors within rounding errors multiplied by the condition of the
    geometry.
    """
    rng = np.random.default_rng(1)
    for _ in range(100):
        b, r = _scene(rng, n, 0.4, 3e-4, random_quaternion(rng))
        w = rng.uniform(0.2, 9.0, n)
        expected = Rotation.align_vectors(b, r, weights=w)[0].as_matrix()
        assert rotation_angle_rad(_as_matrix(name, b, r, w), expected) < 3e-13 * _condition(b, w)


@pytest.mark.parametrize("name", ["quest", "q_method", "svd", "foam"])
@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (1, 1, 0), (1, -1, 1)])
def test_rotations_by_180_degrees_are_not_singular(name: str, axis: tuple[float, float, float]) -> None:
    """A rotation by exactly 180° about any axis is found within rounding errors."""
    rng = np.random.default_rng(2)
    quaternion = np.append(np.array(axis, float) / np.linalg.norm(axis), 0.0)
    b, r = _scene(rng, 6, 0.4, 0.0, quaternion)
    assert rotation_angle_rad(_as_matrix(name, b, r, np.ones(6)), matrix_from_quaternion(quaternion)) < 1e-14


def test_quest_is_accurate_for_two_close_stars() -> None:
    """Two stars less than 0.1° apart give the optimal attitude within rounding errors multiplied by the condition of
    the geometry.
    """
    rng = np.random.default_rng(3)
    for _ in range(50):
        b, r = _scene(rng, 2, 1e-3, 1e-6, random_quaternion(rng))
        expected = Rotation.align_vectors(b, r)[0].as_matrix()
        limit_rad = 1e-13 * _condition(b, np.ones(2))
        assert rotation_angle_rad(matrix_from_quaternion(attitude.quest(b, r)), expected) < limit_rad


def test_the_scale_of_weights_has_no_effect() -> None:
    """Only the ratios of the weights have an effect, and a star with weight zero has none."""
    rng = np.random.default_rng(4)
    b, r = _scene(rng, 5, 0.3, 1e-3, random_quaternion(rng))
    w = np.array([3.0, 4, 4, 3, 0])
    expected = attitude.quest(b, r, w)
    np.testing.assert_allclose(attitude.quest(b, r, 1e6 * w), expected, atol=1e-14)
    np.testing.assert_allclose(attitude.quest(b[:4], r[:4], w[:4]), expected, atol=1e-14)


def test_quaternion_is_unit_with_positive_scalar() -> None:
    """QUEST returns the quaternion with unit length and w ≥ 0."""
    rng = np.random.default_rng(5)
    for _ in range(50):
        quaternion = attitude.quest(*_scene(rng, 4, 0.3, 1e-4, random_quaternion(rng)))
        assert abs(np.linalg.norm(quaternion) - 1) < 1e-14
        assert quaternion[3] >= 0


def test_triad_maps_the_first_direction_exactly() -> None:
    """TRIAD maps the first reference onto the first observation, and the second into the half plane of the second
    observation.
    """
    rng = np.random.default_rng(6)
    b, r = _scene(rng, 2, 0.4, 1e-3, random_quaternion(rng))
    estimate = attitude.triad(b, r)
    np.testing.assert_allclose(estimate @ r[0], b[0], atol=1e-15)
    assert abs(np.cross(b[0], b[1]) @ (estimate @ r[1])) < 1e-15
    np.testing.assert_allclose(estimate @ estimate.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(estimate) > 0


def _scatter(sigma: Array, weights: Array, runs: int) -> tuple[Array, Array]:
    """Return the directions and the sampled covariance of the QUEST error vector in the camera frame."""
    rng = np.random.default_rng(7)
    truth = random_quaternion(rng)
    exact, r = _scene(rng, len(sigma), 0.4, 0.0, truth)
    errors = np.empty((runs, 3))
    for i in range(runs):
        measured = exact + sigma[:, None] * rng.normal(size=exact.shape)
        measured /= np.linalg.norm(measured, axis=1, keepdims=True)
        estimate = matrix_from_quaternion(attitude.quest(measured, r, weights))
        errors[i] = Rotation.from_matrix(estimate @ matrix_from_quaternion(truth).T).as_rotvec()
    return exact, np.cov(errors.T)


def test_covariance_agrees_with_the_scatter() -> None:
    """All nine terms of the predicted covariance agree with the scatter of 4000 noisy solutions, within 8 % of the
    product of both standard deviations.
    """
    sigma = np.array([2e-4, 2e-4, 4e-4, 3e-4, 2e-4, 6e-4])
    exact, scatter = _scatter(sigma, 1 / sigma**2, 4000)
    predicted = attitude.covariance_rad2(exact, sigma)
    scale = np.sqrt(np.outer(np.diag(predicted), np.diag(predicted)))
    np.testing.assert_allclose(scatter / scale, predicted / scale, atol=0.08)


def test_covariance_with_other_weights_agrees_with_the_scatter() -> None:
    """With votes as weights, the sandwich formula predicts the scatter, and it exceeds the covariance with optimal
    weights.
    """
    sigma = np.array([2e-4, 2e-4, 4e-4, 3e-4, 2e-4, 8e-4])
    weights = np.array([1.0, 2, 5, 5, 3, 5])
    exact, scatter = _scatter(sigma, weights, 4000)
    predicted = attitude.weighted_covariance_rad2(exact, weights, sigma)
    scale = np.sqrt(np.outer(np.diag(predicted), np.diag(predicted)))
    np.testing.assert_allclose(scatter / scale, predicted / scale, atol=0.08)
    assert np.linalg.eigvalsh(predicted - attitude.covariance_rad2(exact, sigma))[0] > 0


def test_covariance_of_one_direction_is_infinite() -> None:
    """One star does not determine the rotation about its direction, and the covariance is infinite there."""
    assert np.isinf(attitude.covariance_rad2([[0, 0, 1.0]], 1e-4)).all()


@pytest.mark.parametrize(
    ("observed", "reference", "weights"),
    [
        (np.zeros((0, 3)), np.zeros((0, 3)), None),
        ([[0, 0, 1.0]], [[1.0, 0, 0]], None),
        ([[0, 0, 1.0], [0, 0, 1.0]], [[1.0, 0, 0], [1.0, 0, 0]], None),
        ([[0, 0, 1.0], [0, 1.0, 0]], [[1.0, 0, 0], [0, 1.0, 0]], [1.0, 0.0]),
        ([[0, 0, 1.0], [0, 1.0, 0]], [[1.0, 0, 0], [0, 1.0, 0]], [1.0, -1.0]),
        ([[0, 0, np.nan], [0, 1.0, 0]], [[1.0, 0, 0], [0, 1.0, 0]], None),
        ([[0, 0, 1.0], [0, 1.0, 0]], [[1.0, 0, 0]], None),
    ],
)
def test_too_few_vectors_are_rejected(observed: Array, reference: Array, weights: Array | None) -> None:
    """Fewer than two different directions with positive weight, NaN, negative weights and lists of unequal length raise
    BadInput.
    """
    with pytest.raises(BadInput):
        attitude.quest(observed, reference, weights)

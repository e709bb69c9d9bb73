"""Predictive attitude determination and the covariances of SVD and FOAM, against scipy and against the inverse information."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.domain.rotation import matrix_from_quaternion, quaternion_from_matrix, random_quaternion, rotation_angle_rad
from gss.pipeline.attitude import covariance_rad2
from gss.pipeline.predictive import foam_covariance_rad2, predict, svd_covariance_rad2


def _scene(rng: np.random.Generator, n: int, sigma: Array, rotation: Array) -> tuple[Array, Array]:
    """n directions in a field of 30° with noise, and their references."""
    true = np.column_stack([rng.uniform(-0.27, 0.27, (n, 2)), np.ones(n)])
    true /= np.linalg.norm(true, axis=1, keepdims=True)
    seen = true + sigma[:, None] * rng.normal(size=(n, 3))
    return seen / np.linalg.norm(seen, axis=1, keepdims=True), true @ rotation


def test_the_rate_of_a_turning_camera_is_found() -> None:
    """scipy turns the camera by ω·t; PAD gives ω back within its σ and the new attitude, at 1°/s over a tenth of a second."""
    rng = np.random.default_rng(1)
    for _ in range(50):
        before = matrix_from_quaternion(random_quaternion(rng))
        rate = rng.normal(size=3) * np.radians(1.0)
        # cam_from_icrs after the camera turned by ω·t in its own axes
        after = Rotation.from_rotvec(-rate * 0.1).as_matrix() @ before
        sigma = np.full(8, 2e-5)
        seen, reference = _scene(rng, 8, sigma, after)
        found = predict(quaternion_from_matrix(before), seen, reference, sigma, 0.1)
        spread = np.sqrt(np.diag(found.covariance_rad2))
        second_order = np.linalg.norm(rate * 0.1) ** 2
        assert np.all(np.abs(found.rate_rad_s - rate) * 0.1 < 5 * spread + second_order)
        assert (
            rotation_angle_rad(matrix_from_quaternion(found.quaternion), after)
            < 5 * np.linalg.norm(spread) + second_order
        )


def test_repeated_steps_end_at_the_optimum() -> None:
    """Stepping from one's own answer converges to scipy's align_vectors, from a start 5° off."""
    rng = np.random.default_rng(2)
    truth = matrix_from_quaternion(random_quaternion(rng))
    sigma = np.array([1e-4, 2e-4, 1e-4, 3e-4, 2e-4])
    seen, reference = _scene(rng, 5, sigma, truth)
    q = quaternion_from_matrix(Rotation.from_rotvec([0.05, -0.05, 0.05]).as_matrix() @ truth)
    for _ in range(20):
        q = predict(q, seen, reference, sigma, 1.0).quaternion
    best = Rotation.align_vectors(seen, reference, weights=1 / sigma**2)[0].as_matrix()
    assert rotation_angle_rad(matrix_from_quaternion(q), best) < 1e-7


@pytest.mark.parametrize("form", [svd_covariance_rad2, foam_covariance_rad2])
def test_all_methods_have_one_covariance(form: object) -> None:
    """SVD's and FOAM's covariances are the inverse information within 1e-3 of it (Huffman 2006 eqs. 6.34, 6.53, 6.58)."""
    assert callable(form)
    rng = np.random.default_rng(3)
    for _ in range(20):
        sigma = rng.uniform(5e-5, 3e-4, 7)
        seen, reference = _scene(rng, 7, sigma, matrix_from_quaternion(random_quaternion(rng)))
        expected = covariance_rad2(seen, sigma)
        np.testing.assert_allclose(form(seen, reference, sigma), expected, atol=2e-3 * np.abs(expected).max())


def test_a_prediction_needs_two_directions_and_time() -> None:
    """One star or no interval is refused."""
    one = np.array([[0.0, 0.0, 1.0]])
    with pytest.raises(BadInput, match="rate"):
        predict(np.array([0.0, 0, 0, 1]), one, one, 1e-4, 1.0)
    with pytest.raises(BadInput, match="rate"):
        predict(np.array([0.0, 0, 0, 1]), np.eye(3), np.eye(3), 1e-4, 0.0)

"""The covariances of SVD and FOAM, compared with the inverse information matrix."""

from __future__ import annotations

import numpy as np
import pytest

from gss.domain.angles import Array
from gss.domain.rotation import matrix_from_quaternion, random_quaternion
from gss.pipeline.attitude import covariance_rad2, foam_covariance_rad2, svd_covariance_rad2


def _scene(rng: np.random.Generator, n: int, sigma: Array, rotation: Array) -> tuple[Array, Array]:
    """Return ``n`` noisy directions in a field of 30° and their references."""
    true = np.column_stack([rng.uniform(-0.27, 0.27, (n, 2)), np.ones(n)])
    true /= np.linalg.norm(true, axis=1, keepdims=True)
    measured = true + sigma[:, None] * rng.normal(size=(n, 3))
    return measured / np.linalg.norm(measured, axis=1, keepdims=True), true @ rotation


@pytest.mark.parametrize("covariance_of", [svd_covariance_rad2, foam_covariance_rad2])
def test_all_methods_have_the_same_covariance(covariance_of: object) -> None:
    """The covariances of SVD and FOAM agree with the inverse information matrix within 0.2 % of its largest term
    (Huffman 2006 eqs. 6.34, 6.53, 6.58).
    """
    assert callable(covariance_of)
    rng = np.random.default_rng(3)
    for _ in range(20):
        sigma = rng.uniform(5e-5, 3e-4, 7)
        measured, reference = _scene(rng, 7, sigma, matrix_from_quaternion(random_quaternion(rng)))
        expected = covariance_rad2(measured, sigma)
        np.testing.assert_allclose(
            covariance_of(measured, reference, sigma), expected, atol=2e-3 * np.abs(expected).max()
        )

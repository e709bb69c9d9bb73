"""The covariances of SVD and FOAM, compared with the inverse information matrix."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import least_squares

from gss.domain.angles import Array
from gss.domain.rotation import matrix_from_quaternion, random_quaternion, rotation_from_vector, vector_from_rotation
from gss.pipeline.attitude import (
    covariance_rad2,
    foam_covariance_rad2,
    pad,
    pad_covariance_rad2,
    pixel_information,
    q_method,
    svd_covariance_rad2,
)


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


def test_pad_minimises_the_loss_of_anisotropic_errors() -> None:
    """PAD finds the least squares of errors weighted by R⁻¹, compared with scipy, and equals the q-method if the errors are
    isotropic (Huffman 2006 eqs. 6.13, 6.16)."""
    rng = np.random.default_rng(8)
    sigma = rng.uniform(5e-5, 3e-4, 6)
    measured, reference = _scene(rng, 6, sigma, matrix_from_quaternion(random_quaternion(rng)))
    root = rng.normal(size=(6, 3, 3)) / sigma[:, None, None]
    information = np.einsum("nji,njk->nik", root, root)
    attitude = pad(measured, reference, information)

    def residuals(turn: Array) -> Array:
        off = measured - reference @ (rotation_from_vector(turn * 1e-4) @ attitude).T
        return np.asarray(np.einsum("nij,nj->ni", root, off).ravel())

    assert np.abs(least_squares(residuals, np.full(3, 0.5), xtol=1e-15, ftol=1e-15, gtol=1e-15).x).max() < 0.02
    even = np.eye(3) / sigma[:, None, None] ** 2
    expected = matrix_from_quaternion(q_method(measured, reference, 1 / sigma**2))
    assert np.abs(vector_from_rotation(pad(measured, reference, even) @ expected.T)).max() < 1e-9


def test_the_covariance_of_pad_is_that_of_directions_from_pixels() -> None:
    """The inverse covariance of a direction agrees with the derivative of the direction by the pixel. The errors of PAD have
    the covariance of eq. 6.15."""
    rng = np.random.default_rng(9)
    plane = rng.uniform(-0.4, 0.4, (7, 2))

    def units(xy: Array) -> Array:
        v = np.column_stack([xy, np.ones(len(xy))])
        return np.asarray(v / np.linalg.norm(v, axis=1, keepdims=True))

    sigma, true = np.full(7, 2e-4), units(plane)
    steps = [(units(plane + d) - units(plane - d)) / 2e-6 for d in 1e-6 * np.eye(2)]
    jacobian = np.stack(steps, axis=-1)
    covariance = np.einsum("nij,nkj->nik", jacobian, jacobian) * sigma[0] ** 2
    np.testing.assert_allclose(
        pixel_information(true, sigma), np.linalg.pinv(covariance, rcond=1e-6), rtol=1e-6, atol=1
    )
    predicted = pad_covariance_rad2(true, pixel_information(true, sigma))
    turns = []
    for _ in range(300):
        seen = units(plane + sigma[0] * rng.normal(size=(7, 2)))
        turns.append(vector_from_rotation(pad(seen, true, pixel_information(seen, sigma))))
    np.testing.assert_allclose(np.var(turns, axis=0), np.diag(predicted), rtol=0.3)

"""Angular velocity from two attitudes, compared with scipy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from gss.domain.errors import BadInput
from gss.domain.results import Attitude
from gss.domain.rotation import quaternion_from_matrix, random_quaternion
from gss.pipeline.rates import rate_between

ARCSEC = np.pi / 648_000


def attitude(matrix: np.ndarray, sigma_rad: float = 1e-5) -> Attitude:
    """Return an attitude with the same error about each axis."""
    return Attitude(quaternion_from_matrix(matrix), np.eye(3) * sigma_rad**2)


@given(st.tuples(*[st.floats(-1.0, 1.0)] * 3), st.integers(0, 1000), st.floats(0.05, 60))
def test_a_known_rotation_gives_its_rate(turn: tuple[float, float, float], seed: int, interval_s: float) -> None:
    """The rate is that of the rotation applied with scipy: opposite to the apparent motion of the sky, in camera axes."""
    first = Rotation.from_quat(random_quaternion(np.random.default_rng(seed))).as_matrix()
    second = Rotation.from_rotvec(-np.array(turn)).as_matrix() @ first
    rate = rate_between(attitude(first), attitude(second), interval_s)
    np.testing.assert_allclose(rate.vector_rad_s * interval_s, turn, atol=1e-9)


def test_the_covariance_agrees_with_the_scatter() -> None:
    """The scatter of 4000 noisy pairs agrees with the stated sigma within five per cent."""
    rng, sigma_rad, first = np.random.default_rng(5), 20 * ARCSEC, np.eye(3)
    second = Rotation.from_rotvec([0.0, 0.01, 0.0]).as_matrix()
    rates = []
    for _ in range(4000):
        a, b = (Rotation.from_rotvec(rng.normal(0, sigma_rad, 3)).as_matrix() for _ in range(2))
        rate = rate_between(attitude(a @ first, sigma_rad), attitude(b @ second, sigma_rad), 2.0)
        rates.append(rate.vector_rad_s)
    assert np.std(rates, axis=0) == pytest.approx(rate.sigma_rad_s, rel=0.05)


def test_invalid_intervals_and_rotations_are_rejected() -> None:
    """Images with the same time, and rotations of almost 180°, are rejected."""
    still = attitude(np.eye(3))
    with pytest.raises(BadInput, match="same time"):
        rate_between(still, still, 0.0)
    with pytest.raises(BadInput, match="too large"):
        rate_between(still, attitude(Rotation.from_rotvec([3.1, 0, 0]).as_matrix()), 1.0)

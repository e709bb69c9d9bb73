"""Rotations compared with scipy."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from gss.domain.rotation import (
    matrix_from_quaternion,
    quaternion_from_matrix,
    random_quaternion,
    rotation_angle_rad,
    rotation_from_vector,
    rotation_x,
    rotation_y,
    rotation_z,
    vector_from_rotation,
)


def test_matrix_of_a_quaternion_equals_scipys():
    """A scalar-last quaternion gives the same matrix as scipy's Rotation."""
    rng = np.random.default_rng(3)
    for _ in range(200):
        q = random_quaternion(rng)
        assert np.allclose(matrix_from_quaternion(q), Rotation.from_quat(q).as_matrix(), atol=1e-14)


def test_quaternion_of_a_matrix_is_exact_near_every_half_turn():
    """Shepperd's method keeps full precision where the scalar part is near zero."""
    rng = np.random.default_rng(4)
    axes = np.vstack([np.eye(3), rng.normal(size=(50, 3))])
    for axis in axes / np.linalg.norm(axes, axis=1, keepdims=True):
        for angle in (np.pi, np.pi - 1e-7, 1e-7, 0.0, 2.0):
            m = Rotation.from_rotvec(axis * angle).as_matrix()
            q = quaternion_from_matrix(m)
            assert q[3] >= 0
            assert np.allclose(matrix_from_quaternion(q), m, atol=1e-14)


@pytest.mark.parametrize(("ours", "axis"), [(rotation_x, "x"), (rotation_y, "y"), (rotation_z, "z")])
def test_axis_rotations_change_coordinates_as_jacobs_prints_them(ours, axis):
    """Jacobs 1995 eq. 1.10–1.12 rotate the axes, which is the transpose of scipy's active rotation."""
    assert np.allclose(ours(0.3), Rotation.from_euler(axis, 0.3).as_matrix().T, atol=1e-15)


def test_rotation_vector_and_angle_agree_with_scipy():
    """Rodrigues' rotation and the angle between two rotations equal scipy's, also for small angles."""
    rng = np.random.default_rng(5)
    for scale in (1e-8, 1e-3, 1.0):
        v = rng.normal(size=3) * scale
        assert np.allclose(rotation_from_vector(v), Rotation.from_rotvec(v).as_matrix(), atol=1e-15)
        assert rotation_angle_rad(rotation_from_vector(v), np.eye(3)) == pytest.approx(np.linalg.norm(v), rel=1e-6)


def test_the_rotation_vector_of_a_matrix_is_exact_at_every_angle():
    """The vector equals scipy's from 1 nrad to just below π. At exactly π it is one of the two equivalent vectors."""
    rng = np.random.default_rng(6)
    axes = [axis / np.linalg.norm(axis) for axis in (*rng.normal(size=(20, 3)), *np.eye(3), np.array([1.0, -1.0, 0.0]))]
    for angle_rad in (1e-9, 1e-3, 1.5, np.pi / 2, 3.0, np.pi - 1e-9):
        for axis in axes:
            vector = vector_from_rotation(Rotation.from_rotvec(angle_rad * axis).as_matrix())
            assert np.allclose(vector, angle_rad * axis, rtol=0, atol=1e-14 + 4e-16 * angle_rad)
    for axis in axes:
        vector = vector_from_rotation(2 * np.outer(axis, axis) - np.eye(3))
        assert abs(vector @ axis) == pytest.approx(np.pi, abs=1e-14)
        assert np.linalg.norm(np.cross(vector, axis)) < 1e-14
    assert vector_from_rotation(np.eye(3)).tolist() == [0.0, 0.0, 0.0]

"""Attitude prediction from the last attitudes at equal time steps (Jacobs 1995 §4.1.8, app. E.2)."""

from __future__ import annotations

import numpy as np

from gss.domain.angles import Array
from gss.domain.rotation import matrix_from_quaternion, quaternion_from_matrix, rotation_from_vector

# Weights, newest first: constant acceleration (eq. 4.22), constant velocity (eq. 4.23), last value.
WEIGHTS: dict[int, tuple[float, ...]] = {3: (2.5, -2.0, 0.5), 2: (2.0, -1.0), 1: (1.0,)}


def predict(samples: Array) -> Array:
    """Predict the next value of (k, …) samples, newest first; only the newest three are used."""
    values = np.asarray(samples, float)
    weights = WEIGHTS[min(3, len(values))]
    return np.asarray(np.tensordot(weights, values[: len(weights)], axes=1))


def predict_angles_rad(samples_rad: Array) -> Array:
    """As :func:`predict`, for angles (k, …) that may jump by 2π: differences are wrapped to the shortest."""
    values = np.asarray(samples_rad, float)
    unrolled = np.unwrap(values, axis=0)
    return predict(unrolled)


def predict_attitude(last: Array, earlier: tuple[Array, ...]) -> Array:
    """Predict the (3, 3) attitude one step ahead from quaternions: the last, and the earlier ones, newest first.

    The document predicts roll, pitch and yaw relative to the orbit frame. Here the weights are applied to the small rotation
    vectors relative to the last attitude, which have no singularity; the orbital rotation is part of the motion.
    """
    newest = matrix_from_quaternion(last)
    against = [rotation_vector_rad(matrix_from_quaternion(q) @ newest.T) for q in earlier[:2]]
    return np.asarray(rotation_from_vector(predict(np.array([np.zeros(3), *against]))) @ newest)


def rotation_vector_rad(matrix: Array) -> Array:
    """(3,) rotation vector of a (3, 3) rotation; inverse of ``rotation_from_vector``."""
    q = quaternion_from_matrix(matrix)
    sine = float(np.linalg.norm(q[:3]))
    scale = 2 * np.arctan2(sine, q[3]) / sine if sine > 1e-300 else 2.0
    return np.asarray(q[:3] * scale)

"""Attitude prediction from the last attitudes and their times (Jacobs 1995 §4.1.8, app. E.2)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gss.domain.angles import Array
from gss.domain.rotation import matrix_from_quaternion, quaternion_from_matrix, rotation_from_vector

EVERY_SECOND_S = (1.0, 2.0, 3.0)
MAX_CURVED = 1.5
"""Number of steps ahead up to which the acceleration is used. For more steps, the error of the acceleration, which
grows quadratically, exceeds its benefit."""


def weights(ages_s: Sequence[float]) -> Array:
    """Return the (k,) weights of one to three samples, newest first, that predict the present value. ``ages_s``: ages
    of the samples. Three samples assume constant acceleration, two constant velocity, one a constant value. At equal
    steps the weights are 2.5, −2, 0.5 (eq. 4.22) and 2, −1 (eq. 4.23)."""
    age = np.asarray(ages_s[:3], float)
    if len(age) == 1:
        return np.ones(1)
    ahead, step = age[0], np.diff(age)
    out = np.zeros(len(age))
    out[:2] = 1 + ahead / step[0], -ahead / step[0]
    if len(age) == len(EVERY_SECOND_S) and ahead <= MAX_CURVED * step[0]:
        # The acceleration is the change of the velocity between the middles of the two intervals.
        out += ahead**2 / step.sum() * np.array([1 / step[0], -1 / step[0] - 1 / step[1], 1 / step[1]])
    return out


def predict(samples: Array, ages_s: Sequence[float] = EVERY_SECOND_S) -> Array:
    """Predict the present value from (k, …) samples, newest first; only the newest three are used."""
    values = np.asarray(samples, float)[:3]
    return np.asarray(np.tensordot(weights(ages_s[: len(values)]), values, axes=1))


def predict_attitude(last: Array, earlier: tuple[Array, ...], ages_s: Sequence[float] = EVERY_SECOND_S) -> Array:
    """Predict the present (3, 3) attitude from the last quaternion and the earlier ones, newest first, with their ages.

    The document predicts roll, pitch and yaw relative to the orbit frame. Here the weights are applied to
    small rotation vectors relative to the last attitude, because these vectors have no singularity. The orbital rotation
    is part of the motion.
    """
    newest = matrix_from_quaternion(last)
    against = [rotation_vector_rad(matrix_from_quaternion(q) @ newest.T) for q in earlier[:2]]
    return np.asarray(rotation_from_vector(predict(np.array([np.zeros(3), *against]), ages_s)) @ newest)


def rotation_vector_rad(matrix: Array) -> Array:
    """Return the (3,) rotation vector of a (3, 3) rotation; inverse of ``rotation_from_vector``."""
    q = quaternion_from_matrix(matrix)
    sine = float(np.linalg.norm(q[:3]))
    scale = 2 * np.arctan2(sine, q[3]) / sine if sine > 1e-300 else 2.0
    return np.asarray(q[:3] * scale)

"""Attitude prediction at a constant rate, and combination of several attitude estimates (Liebe 1992, "Algorithms" and
"Predictional estimate"), by their times."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gss.domain.angles import Array
from gss.domain.rotation import matrix_from_quaternion, quaternion_from_matrix, rotation_from_vector
from gss.pipeline.track.predictor import rotation_vector_rad


def extrapolate(last: Array, before: Array, steps: float = 1.0) -> Array:
    """Return the (3, 3) attitude of the next frame from the (4,) quaternions of the last two, at the rate between them.

    ``steps``: time to the next frame in units of the time between the last two frames."""
    now, then = matrix_from_quaternion(last), matrix_from_quaternion(before)
    turn = now @ then.T
    if steps != 1.0:
        turn = rotation_from_vector(steps * rotation_vector_rad(turn))
    return np.asarray(turn @ now)


def average_estimates(
    quaternions: Sequence[Array], weights: Sequence[float] | None = None, ages_s: Sequence[float] = ()
) -> Array:
    """Return the (4,) quaternion of the newest of n attitudes (newest first), smoothed by fitting a constant rate to
    all.

    ``ages_s``: (n,) ages of the attitudes, by default equal steps.

    The document averages successive estimates, which lags behind a rotating satellite. Here a straight line is fitted
    to the small rotations relative to the newest attitude and evaluated at its time. The newest of one or two attitudes
    is returned unchanged. The error of a line through n attitudes is about 2/√n times the error of one estimate.
    """
    newest = matrix_from_quaternion(quaternions[0])
    if len(quaternions) < 3:
        return quaternion_from_matrix(newest)
    turns = np.stack([rotation_vector_rad(matrix_from_quaternion(q) @ newest.T) for q in quaternions])
    age = np.asarray(ages_s, float) if len(ages_s) else np.arange(len(turns), dtype=float)
    line = np.vander(-age, 2)
    scale = np.ones(len(turns)) if weights is None else np.sqrt(np.asarray(weights, float))
    solution = np.linalg.lstsq(line * scale[:, None], turns * scale[:, None], rcond=None)[0]
    return quaternion_from_matrix(rotation_from_vector(solution[1]) @ newest)

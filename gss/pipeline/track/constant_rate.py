"""Attitude prediction at a constant rate, and combination of several attitude estimates (Liebe 1992, "Algorithms" and
"Predictional estimate"). Frames are assumed to be equally spaced in time."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from gss.domain.angles import Array
from gss.domain.rotation import matrix_from_quaternion, quaternion_from_matrix, rotation_from_vector


def vector_from_rotation_rad(rotation: Array) -> Array:
    """(3,) rotation vector of a (3, 3) rotation, the inverse of ``rotation_from_vector``."""
    q = quaternion_from_matrix(rotation)
    sine = float(np.linalg.norm(q[:3]))
    return np.asarray(q[:3] * (2 * np.arctan2(sine, q[3]) / sine if sine > 1e-300 else 2.0))


def extrapolate(last: Array, before: Array) -> Array:
    """(3, 3) attitude of the next frame from the (4,) quaternions of the last two, repeating the rotation between them."""
    now, then = matrix_from_quaternion(last), matrix_from_quaternion(before)
    return np.asarray((now @ then.T) @ now)


def average_estimates(quaternions: Sequence[Array], weights: Sequence[float] | None = None) -> Array:
    """(4,) quaternion of the newest of n attitudes (newest first), smoothed by fitting a constant rate to all.

    The document accumulates averages of successive estimates. Averaging lags behind a rotating satellite, so a straight
    line is fitted to the small rotations relative to the newest attitude and evaluated there. One or two attitudes
    return the newest unchanged; a line through n has about 2/√n of one estimate's error. For a satellite at rest,
    :func:`mean_attitude` achieves 1/√n.
    """
    newest = matrix_from_quaternion(quaternions[0])
    if len(quaternions) < 3:
        return quaternion_from_matrix(newest)
    turns = np.stack([vector_from_rotation_rad(matrix_from_quaternion(q) @ newest.T) for q in quaternions])
    line = np.vander(-np.arange(len(turns), dtype=float), 2)
    scale = np.ones(len(turns)) if weights is None else np.sqrt(np.asarray(weights, float))
    solution = np.linalg.lstsq(line * scale[:, None], turns * scale[:, None], rcond=None)[0]
    return quaternion_from_matrix(rotation_from_vector(solution[1]) @ newest)


def mean_attitude(quaternions: Sequence[Array], weights: Sequence[float] | None = None) -> Array:
    """(4,) mean quaternion of n attitudes of a camera at rest: eigenvector of Σ w q qᵀ with the largest eigenvalue."""
    q = np.stack([np.asarray(x, float) / np.linalg.norm(x) for x in quaternions])
    w = np.ones(len(q)) if weights is None else np.asarray(weights, float)
    middle = np.linalg.eigh((w[:, None] * q).T @ q)[1][:, -1]
    return np.asarray(-middle if middle[3] < 0 else middle)

"""Differential correction of a known attitude: small angles from small deviations, repeated (Moniteq 1983 §6.2; Liebe
1992, "Predictional estimate").

For a small rotation w, a predicted direction p moves by w × p. Its components perpendicular to p equal those of the
measured deviation, which gives two equations per star. The least-squares solution is converted to an exact rotation,
and the deviations are computed again. The linear form of the documents alone leaves an error of 63″ for a correction of
1°.
"""

from __future__ import annotations

import numpy as np

from gss.domain.angles import Array
from gss.domain.rotation import rotation_from_vector

STEPS = 10
CONVERGED_RAD = 1e-12


def small_rotation_rad(predicted_cam: Array, measured_cam: Array, weights: Array) -> Array | None:
    """Return the (3,) rotation vector from (n, 3) predicted to measured directions. None if the stars do not determine all axes."""
    normal = _information(predicted_cam, weights)
    if np.linalg.eigvalsh(normal)[0] <= 1e-14 * np.trace(normal):
        return None
    torque = np.sum(weights[:, None] * np.cross(predicted_cam, measured_cam), axis=0)
    return np.asarray(np.linalg.solve(normal, torque))


def _information(unit: Array, weights: Array) -> Array:
    """Return the information matrix Σ w (1 − p pᵀ)."""
    return np.asarray(np.sum(weights) * np.eye(3) - (weights[:, None] * unit).T @ unit)


def differential_attitude(
    measured_cam: Array, reference_icrs: Array, cam_from_icrs: Array, weights: Array | None = None, steps: int = STEPS
) -> Array | None:
    """Return the (3, 3) cam_from_icrs from n pairs of unit vectors and a nearby attitude. None if the stars do not
    determine all three axes or the corrections do not converge. ``steps`` = 1 gives the single linear solution of the
    documents."""
    attitude = np.asarray(cam_from_icrs, float)
    w = np.ones(len(measured_cam)) if weights is None else np.asarray(weights, float)
    if len(measured_cam) < 2:
        return None
    turn = None
    for _ in range(steps):
        turn = small_rotation_rad(reference_icrs @ attitude.T, measured_cam, w)
        if turn is None:
            return None
        attitude = rotation_from_vector(turn) @ attitude
        if np.linalg.norm(turn) < CONVERGED_RAD:
            break
    settled = turn is not None and (steps == 1 or float(np.linalg.norm(turn)) < 1e-6)
    return attitude if settled else None

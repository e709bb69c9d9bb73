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
CONVERGED_RAD, SETTLED_RAD = 1e-12, 1e-6
"""Last correction that ends the steps, and largest last correction of a result."""
SINGULAR = 1e-14
"""Ratio of the smallest eigenvalue of the normal matrix to its trace up to which the stars do not determine an axis."""


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
    # The sums over all stars, Σ w m rᵀ and Σ w (1 − r rᵀ), rotate with the attitude, so they are computed once.
    weighted = w[:, None] * reference_icrs
    profile = measured_cam.T @ weighted
    normal = float(w.sum()) * np.eye(3) - weighted.T @ reference_icrs
    if np.linalg.eigvalsh(normal)[0] <= SINGULAR * np.trace(normal):
        return None
    turn = None
    for _ in range(steps):
        turned = profile @ attitude.T
        torque = (turned.T - turned)[(1, 2, 0), (2, 0, 1)]
        turn = np.linalg.solve(attitude @ normal @ attitude.T, torque)
        attitude = rotation_from_vector(turn) @ attitude
        if np.linalg.norm(turn) < CONVERGED_RAD:
            break
    settled = turn is not None and (steps == 1 or float(np.linalg.norm(turn)) < SETTLED_RAD)
    return attitude if settled else None

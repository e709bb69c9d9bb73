"""Predictive attitude determination (PAD): the angular rate that propagates the last attitude to the new measurements, and
covariances in the forms of the other solvers (Huffman 2006 §6.1.2, §6.1.4–6.1.5)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.domain.rotation import matrix_from_quaternion, quaternion_from_matrix, rotation_from_vector
from gss.pipeline.attitude import profile_matrix


@dataclass(frozen=True)
class Prediction:
    """``rate_rad_s``: (3,) angular velocity of the camera in camera axes. ``quaternion``: cam_from_icrs at the new time.
    ``covariance_rad2``: (3, 3) covariance of its small rotation vector."""

    rate_rad_s: Array
    quaternion: Array
    covariance_rad2: Array


def predict(
    quaternion: ArrayLike, observed: ArrayLike, reference: ArrayLike, sigma_rad: ArrayLike, interval_s: float
) -> Prediction:
    """Do one PAD step: find the constant rate over ``interval_s`` that best fits the (n, 3) ``observed`` directions at its end.

    Eq. 6.13 with isotropic errors (its eq. 6.17 lacks a minus sign). The step is linear in the angle; the second-order error is
    removed if the caller steps again from the result with a very short interval, or steps often enough.
    """
    q = np.asarray(quaternion, float)
    b, r = np.asarray(observed, float).reshape(-1, 3), np.asarray(reference, float).reshape(-1, 3)
    sigma = np.broadcast_to(np.asarray(sigma_rad, float), len(b))
    if len(b) < 2 or b.shape != r.shape or not interval_s > 0:
        raise BadInput(
            "no rate can be predicted",
            expected="two pairs of directions or more, interval above 0 s",
            got=f"{b.shape}, {r.shape}, {interval_s} s",
        )
    rotation = matrix_from_quaternion(q)
    expected = r @ rotation.T
    weight = 1 / sigma**2
    information = np.sum(weight) * np.eye(3) - (weight[:, None] * expected).T @ expected
    # If the camera rotates by +θ, the stars rotate by −θ in its frame: observed − expected = expected × θ.
    pull = np.sum(weight[:, None] * np.cross(b - expected, expected), axis=0)
    turn = np.linalg.solve(information, pull)
    return Prediction(
        turn / interval_s,
        quaternion_from_matrix(rotation_from_vector(-turn) @ rotation),
        np.asarray(np.linalg.inv(information)),
    )


def svd_covariance_rad2(observed: ArrayLike, reference: ArrayLike, sigma_rad: ArrayLike) -> Array:
    """(3, 3) covariance of the SVD method: U diag(σ²/(s_j + s_k)) Uᵀ with the third singular value signed.

    With weights σ_tot²/σ² this is eq. 6.53's result up to terms of the residuals.
    """
    b, total = _weighted(observed, reference, sigma_rad)
    u, s, vt = np.linalg.svd(b)
    signed = s * [1, 1, np.sign(np.linalg.det(u) * np.linalg.det(vt))]
    between = np.array([signed[1] + signed[2], signed[2] + signed[0], signed[0] + signed[1]])
    return np.asarray(total * (u * (1 / between)) @ u.T)


def foam_covariance_rad2(observed: ArrayLike, reference: ArrayLike, sigma_rad: ArrayLike) -> Array:
    """(3, 3) covariance of FOAM: σ_tot² (κ1 + BBᵀ)/ζ (eq. 6.58, with λ = 1 for small residuals)."""
    b, total = _weighted(observed, reference, sigma_rad)
    s1, s2, s3 = np.linalg.svd(b, compute_uv=False) * [1, 1, np.sign(np.linalg.det(b)) or 1.0]
    kappa = s2 * s3 + s3 * s1 + s1 * s2
    zeta = (s2 + s3) * (s3 + s1) * (s1 + s2)
    return np.asarray(total * (kappa * np.eye(3) + b @ b.T) / zeta)


def _weighted(observed: ArrayLike, reference: ArrayLike, sigma_rad: ArrayLike) -> tuple[Array, float]:
    """Profile matrix with weights σ_tot²/σ², and σ_tot² (eqs. 6.35 and 6.36)."""
    sigma = np.broadcast_to(np.asarray(sigma_rad, float), len(np.asarray(observed)))
    information = 1 / sigma**2
    return profile_matrix(observed, reference, information), float(1 / np.sum(information))

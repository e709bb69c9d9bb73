"""Attitude from matched directions (TRIAD, QUEST, q-method, SVD, FOAM) and its covariance.

All methods take ``observed`` (n, 3) unit vectors in the camera frame, ``reference`` (n, 3) unit vectors in ICRS and
``weights`` (n,) ≥ 0 of any scale, and minimise Wahba's loss ½ Σ w |observed − cam_from_icrs · reference|²
(Erlank 2013 eq. 4.4.8). They need at least two directions that are not parallel and raise :class:`BadInput` otherwise.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from gss.domain.angles import Array, cross
from gss.domain.errors import BadInput
from gss.domain.rotation import rotation_from_vector

NEWTON_STEPS = 8
NEWTON_CONVERGED = 1e-15
RAYLEIGH_STEPS = 2
PARALLEL = 1e-9
PAD_STEPS = 4

# Multiplying the columns of the profile matrix by a row of signs rotates the reference by 180° about x, y or z; the
# last row leaves it unchanged.
_HALF_TURN_SIGNS = np.array([[1.0, -1.0, -1.0], [-1.0, 1.0, -1.0], [-1.0, -1.0, 1.0], [1.0, 1.0, 1.0]])
_HALF_TURN_QUATERNIONS = np.eye(4)


def triad(observed: ArrayLike, reference: ArrayLike) -> Array:
    """Return the (3, 3) cam_from_icrs from two directions. It maps the first direction exactly (Erlank 2013 eq.
    4.4.1–7)."""
    b, r, _ = _checked(observed, reference, None)
    return np.asarray(_triad_axes(b).T @ _triad_axes(r))


def _triad_axes(v: Array) -> Array:
    """Return the rows t1, t2, t3 of the intermediate frame."""
    across = cross(v[0], v[1])
    across /= np.linalg.norm(across)
    return np.stack([v[0], across, cross(v[0], across)])


def profile_matrix(observed: ArrayLike, reference: ArrayLike, weights: ArrayLike | None = None) -> Array:
    """Return the (3, 3) attitude profile matrix B = Σ w observed referenceᵀ, with weights scaled to sum 1."""
    b, r, w = _checked(observed, reference, weights)
    return np.asarray((w[:, None] * b).T @ r)


def quest(observed: ArrayLike, reference: ArrayLike, weights: ArrayLike | None = None) -> Array:
    """Return the (4,) scalar-last quaternion cam_from_icrs by QUEST (Erlank 2013 eq. 4.4.9–10).

    The document uses λ = Σw. This estimate is refined by Newton's method on the characteristic quartic, as by Shuster.
    Two Rayleigh quotients then refine it further, because the quartic loses digits if all stars are close together.
    Rotations near 180°, where the Rodrigues parameters are infinite, are avoided by first rotating the reference by
    180° about the axis that leaves the smallest rotation.
    """
    profile = profile_matrix(observed, reference, weights)
    half_turn = int(np.argmax(_HALF_TURN_SIGNS @ np.diag(profile)))
    q = _quest_near_identity(profile * _HALF_TURN_SIGNS[half_turn])
    q = _product(q, _HALF_TURN_QUATERNIONS[half_turn])
    return -q if q[3] < 0 else q


def _quest_near_identity(profile: Array) -> Array:
    """Return the quaternion that maximises qᵀKq, if its scalar part is not small. ``profile``: from weights with sum 1."""
    s, z, sigma = _davenport_parts(profile)
    k = _davenport(s, z, sigma)
    largest = _largest_root(s, z, sigma)
    q = _from_rodrigues(s, z, sigma, largest)
    for _ in range(RAYLEIGH_STEPS):
        q = _from_rodrigues(s, z, sigma, float(q @ k @ q))
    return q


def _from_rodrigues(s: Array, z: Array, sigma: float, largest: float) -> Array:
    """Solve [(λ + σ)1 − S] p = Z and normalise (p, 1) (Erlank 2013 eq. 4.4.9–10)."""
    p = np.linalg.solve((largest + sigma) * np.eye(3) - s, z)
    q = np.append(p, 1.0)
    return np.asarray(q / np.linalg.norm(q))


def _largest_root(s: Array, z: Array, sigma: float) -> float:
    """Return the largest eigenvalue of Davenport's matrix: a root of its characteristic quartic, by Newton's method
    from λ = Σw = 1 downwards."""
    minors = 0.5 * (np.trace(s) ** 2 - np.sum(s * s))
    a, b = sigma**2 - minors, sigma**2 + z @ z
    c, d = np.linalg.det(s) + z @ s @ z, z @ s @ s @ z
    x = 1.0
    for _ in range(NEWTON_STEPS):
        value = ((x * x - a - b) * x - c) * x + (a * b + c * sigma - d)
        slope = (4 * x * x - 2 * (a + b)) * x - c
        step = value / slope if slope > 0 else 0.0
        x = min(1.0, x - step)
        if abs(step) < NEWTON_CONVERGED:
            break
    return float(x)


def q_method(observed: ArrayLike, reference: ArrayLike, weights: ArrayLike | None = None) -> Array:
    """Return the (4,) scalar-last quaternion cam_from_icrs: eigenvector of Davenport's matrix (Huffman 2006 eq. 6.21–6.24)."""
    parts = _davenport_parts(profile_matrix(observed, reference, weights))
    q = np.linalg.eigh(_davenport(*parts))[1][:, -1]
    return np.asarray(-q if q[3] < 0 else q)


def svd(observed: ArrayLike, reference: ArrayLike, weights: ArrayLike | None = None) -> Array:
    """Return the (3, 3) cam_from_icrs by singular value decomposition (Huffman 2006 eq. 6.50)."""
    u, _, vt = np.linalg.svd(profile_matrix(observed, reference, weights))
    sign = np.linalg.det(u) * np.linalg.det(vt)
    return np.asarray(u @ np.diag([1.0, 1.0, np.sign(sign)]) @ vt)


def pad(observed: ArrayLike, reference: ArrayLike, information: Array) -> Array:
    """Return the (3, 3) cam_from_icrs by Predictive Attitude Determination (Huffman 2006 eq. 6.9–6.14), for anisotropic
    errors: ``information`` (n, 3, 3) is the inverse covariance R⁻¹ of each observed direction.

    The document predicts from the attitude of the last frame. Here the start is TRIAD on the widest pair of directions, and
    the correction is repeated, so that the result does not depend on the start.
    """
    b, r, _ = _checked(observed, reference, None)
    widest = np.unravel_index(int(np.argmin(b @ b.T)), (len(b), len(b)))
    attitude = triad(b[list(widest)], r[list(widest)])
    for _ in range(PAD_STEPS):
        predicted = r @ attitude.T
        cross = _cross_matrices(predicted)
        right = np.einsum("nij,njk,nk->i", cross, information, b - predicted)
        turn_rad = np.linalg.solve(np.einsum("nij,njk,nkl->il", cross, information, cross), right)
        attitude = rotation_from_vector(-turn_rad) @ attitude
    return np.asarray(attitude)


def pad_covariance_rad2(predicted: Array, information: Array) -> Array:
    """Return the (3, 3) covariance in the camera frame of PAD (Huffman 2006 eq. 6.15). ``predicted``: (n, 3) directions."""
    cross = _cross_matrices(predicted)
    return np.asarray(np.linalg.inv(np.einsum("nij,njk,nlk->il", cross, information, cross)))


def pixel_information(unit_cam: Array, sigma_rad: Array) -> Array:
    """Return the (n, 3, 3) inverse covariances of directions whose errors are equal along the rows and columns of the
    detector. ``sigma_rad``: (n,) error on the optical axis. At the angle θ from the axis, the error is cos²θ of this value
    towards the axis and cos θ of it around the axis."""
    axis = np.array([0.0, 0.0, 1.0])
    across = cross(axis, unit_cam)
    length = np.linalg.norm(across, axis=1, keepdims=True)
    across = np.where(length > PARALLEL, across / np.maximum(length, PARALLEL), np.array([1.0, 0.0, 0.0]))
    radial = cross(across, unit_cam)
    cosine = unit_cam[:, 2]
    outer = [
        v[:, :, None] * v[:, None, :] / (sigma_rad * cosine**n)[:, None, None] ** 2
        for v, n in ((radial, 2), (across, 1))
    ]
    return np.asarray(outer[0] + outer[1])


def _cross_matrices(v: Array) -> Array:
    """Return the (n, 3, 3) matrices [v×] (eq. 6.14)."""
    x, y, z = v.T
    zero = np.zeros_like(x)
    return np.stack([np.stack([zero, -z, y], -1), np.stack([z, zero, -x], -1), np.stack([-y, x, zero], -1)], -2)


def foam(observed: ArrayLike, reference: ArrayLike, weights: ArrayLike | None = None) -> Array:
    """Return the (3, 3) cam_from_icrs by Markley's FOAM with signed singular values (Huffman 2006 eq. 6.54)."""
    b = profile_matrix(observed, reference, weights)
    s1, s2, s3 = np.linalg.svd(b, compute_uv=False) * [1, 1, np.sign(np.linalg.det(b)) or 1.0]
    kappa, largest = s2 * s3 + s3 * s1 + s1 * s2, s1 + s2 + s3
    zeta = (s2 + s3) * (s3 + s1) * (s1 + s2)
    return np.asarray(((kappa + np.sum(b * b)) * b + largest * _cofactors(b) - b @ b.T @ b) / zeta)


def _cofactors(m: Array) -> Array:
    """Return the cofactors (transposed adjugate) of a (3, 3) matrix from cross products of its rows. The matrix can be singular."""
    return np.stack([cross(m[1], m[2]), cross(m[2], m[0]), cross(m[0], m[1])])


def covariance_rad2(observed_cam: ArrayLike, sigma_rad_per_star: ArrayLike) -> Array:
    """Return the (3, 3) covariance of the small rotation vector, camera frame, rad²: the inverse Fisher information.

    ``sigma_rad_per_star``: scalar or (n,), standard deviation per axis of each measured direction. If the weights are
    1/σ², the result is the QUEST covariance (Huffman 2006 eq. 6.34, times four for angles). The result is infinite if
    the directions do not determine all three axes.
    """
    b = np.asarray(observed_cam, float).reshape(-1, 3)
    sigma = np.broadcast_to(np.asarray(sigma_rad_per_star, float), len(b))
    return _inverse(_information(b, 1.0 / sigma**2))


def weighted_covariance_rad2(observed_cam: ArrayLike, weights: ArrayLike, sigma_rad_per_star: ArrayLike) -> Array:
    """Return the covariance of an attitude whose ``weights`` (n,) are not 1/σ², for example votes. See
    :func:`covariance_rad2`."""
    b = np.asarray(observed_cam, float).reshape(-1, 3)
    w = np.asarray(weights, float)
    sigma = np.broadcast_to(np.asarray(sigma_rad_per_star, float), len(b))
    gain = _inverse(_information(b, w))
    return np.asarray(gain @ _information(b, (w * sigma) ** 2) @ gain) if np.isfinite(gain).all() else gain


def svd_covariance_rad2(observed: ArrayLike, reference: ArrayLike, sigma_rad: ArrayLike) -> Array:
    """Return the (3, 3) covariance of the SVD method: U diag(σ²/(s_j + s_k)) Uᵀ with the third singular value signed.

    With weights σ_tot²/σ² the result equals eq. 6.53, except for terms that contain residuals.
    """
    b, total = _weighted(observed, reference, sigma_rad)
    u, s, vt = np.linalg.svd(b)
    signed = s * [1, 1, np.sign(np.linalg.det(u) * np.linalg.det(vt))]
    between = np.array([signed[1] + signed[2], signed[2] + signed[0], signed[0] + signed[1]])
    return np.asarray(total * (u * (1 / between)) @ u.T)


def foam_covariance_rad2(observed: ArrayLike, reference: ArrayLike, sigma_rad: ArrayLike) -> Array:
    """Return the (3, 3) covariance of FOAM: σ_tot² (κ1 + BBᵀ)/ζ (eq. 6.58, with λ = 1 for small residuals)."""
    b, total = _weighted(observed, reference, sigma_rad)
    s1, s2, s3 = np.linalg.svd(b, compute_uv=False) * [1, 1, np.sign(np.linalg.det(b)) or 1.0]
    kappa = s2 * s3 + s3 * s1 + s1 * s2
    zeta = (s2 + s3) * (s3 + s1) * (s1 + s2)
    return np.asarray(total * (kappa * np.eye(3) + b @ b.T) / zeta)


def _weighted(observed: ArrayLike, reference: ArrayLike, sigma_rad: ArrayLike) -> tuple[Array, float]:
    """Return the profile matrix with weights σ_tot²/σ², and σ_tot² (eqs. 6.35 and 6.36)."""
    sigma = np.broadcast_to(np.asarray(sigma_rad, float), len(np.asarray(observed)))
    information = 1 / sigma**2
    return profile_matrix(observed, reference, information), float(1 / np.sum(information))


def _information(b: Array, weight: Array) -> Array:
    """Return the information matrix Σ w (1 − b bᵀ)."""
    return np.asarray(np.sum(weight) * np.eye(3) - (weight[:, None] * b).T @ b)


def _inverse(information: Array) -> Array:
    values = np.linalg.eigvalsh(information)
    if not values[0] > 1e-15 * max(values[-1], 1e-300):
        return np.full((3, 3), np.inf)
    return np.asarray(np.linalg.inv(information))


def _davenport_parts(profile: Array) -> tuple[Array, Array, float]:
    """Return S, Z and σ of eq. 4.4.9. The sign of Z is opposite to the document's, because the document uses Shuster's
    quaternion convention (coordinates rotate) and this module uses the convention of ``gss.domain.rotation``."""
    z = np.array([profile[2, 1] - profile[1, 2], profile[0, 2] - profile[2, 0], profile[1, 0] - profile[0, 1]])
    return profile + profile.T, z, float(np.trace(profile))


def _davenport(s: Array, z: Array, sigma: float) -> Array:
    """Return the (4, 4) matrix K. The eigenvector of its largest eigenvalue is the quaternion."""
    k = np.empty((4, 4))
    k[:3, :3] = s - sigma * np.eye(3)
    k[:3, 3] = k[3, :3] = z
    k[3, 3] = sigma
    return k


def _product(p: Array, q: Array) -> Array:
    """Return the scalar-last quaternion of matrix(p) @ matrix(q)."""
    vector = p[3] * q[:3] + q[3] * p[:3] + cross(p[:3], q[:3])
    return np.append(vector, p[3] * q[3] - p[:3] @ q[:3])


def _checked(observed: ArrayLike, reference: ArrayLike, weights: ArrayLike | None) -> tuple[Array, Array, Array]:
    """Return validated arrays of equal length with the weights scaled to sum one. Raises :class:`BadInput`."""
    b, r = np.asarray(observed, float), np.asarray(reference, float)
    w = np.ones(len(b)) if weights is None else np.asarray(weights, float)
    if b.ndim != 2 or b.shape != r.shape or b.shape[1] != 3 or w.shape != (len(b),):
        raise BadInput(
            "directions do not pair up",
            expected="(n, 3) observed, (n, 3) reference and (n,) weights",
            got=f"{b.shape}, {r.shape} and {w.shape}",
        )
    if np.any(w < 0) or not (np.isfinite(b).all() and np.isfinite(r).all() and np.isfinite(w).all()):
        raise BadInput("directions or weights are unusable", expected="finite numbers, weights ≥ 0")
    used = w > 0
    if np.count_nonzero(used) < 2 or _all_parallel(b[used]) or _all_parallel(r[used]):
        raise BadInput(
            "an attitude needs two directions that are not parallel", got=f"{np.count_nonzero(used)} with weight"
        )
    return b, r, w / np.sum(w)


def _all_parallel(v: Array) -> bool:
    (x, y, z), (a, b, c) = v[0], v[1:].T
    # The cross product is written out, because numpy's function takes longer than the calculation for a dozen vectors.
    return bool(((y * c - z * b) ** 2 + (z * a - x * c) ** 2 + (x * b - y * a) ** 2).max() < PARALLEL**2)

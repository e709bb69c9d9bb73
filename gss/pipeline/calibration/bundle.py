"""Joint fit of one camera and the attitudes of all frames: bundle adjustment with the attitudes eliminated.

The position of a star depends on the three angles of its frame and on the few camera parameters. Therefore the matrix
of the normal equations consists of a 3 x 3 block for each frame, a border, and a small corner block. The Schur
complement of the frame blocks is the information about the camera alone (Triggs et al. 2000 §6.1). Its inverse is the
covariance of the camera including the errors of all attitudes.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.rotation import matrix_from_quaternion, rotation_from_vector
from gss.pipeline.calibration.lens_models import Vector, difference_steps
from gss.pipeline.calibration.star_stack import StarStack

ROUNDS = 40
DONE = 1e-12
SETTLED = 1e-6  # convergence limit, in squared standard deviations of all stars together
HUBER = 2.5  # scaled residuals beyond this length have linear loss
REJECT = 5.0  # scaled residuals beyond this length are rejected
RAYLEIGH_MEDIAN = 1.1774
TURN_STEP_RAD = 1e-6
DAMPED, EASED = 10.0, 0.2


@dataclass(frozen=True)
class Prior:
    """Prior value of a parameter, for example from a bench measurement. ``sigma`` has the unit of the parameter: pixels
    for the focal length and the centre, radians for tilts."""

    value: float
    sigma: float


@dataclass(frozen=True)
class Adjusted:
    """Result of a fit. ``residual_px``: (n, 2) measured − predicted. ``used``: (n,) False if rejected. ``scale``: ratio of the
    actual to the stated errors of the stars. ``covariance``: of the free parameters (in the units of ``Vector.value``), including
    the errors of all attitudes. ``attitude_covariance_rad2``: (f, 3, 3), including the camera's error."""

    vector: Vector
    cam_from_icrs: Array
    residual_px: Array
    used: NDArray[np.bool_]
    scale: float
    covariance: Array
    attitude_covariance_rad2: Array
    freedom: int

    @property
    def camera(self) -> Camera:
        """Return the fitted camera."""
        return self.vector.camera()


@dataclass(frozen=True)
class _Normal:
    blocks: Array
    border: Array
    corner: Array
    turn: Array
    move: Array


def adjust(
    stars: StarStack,
    vector: Vector,
    cam_from_icrs: Array,
    priors: Mapping[str, Prior] | None = None,
    *,
    rounds: int = ROUNDS,
    used: NDArray[np.bool_] | None = None,
) -> Adjusted:
    """Fit all (f, 3, 3) attitudes and the free parameters by Levenberg–Marquardt with Huber loss. Stars beyond 5 σ of
    the measured scatter are rejected. ``used``: fixed selection of stars, with which no star is rejected."""
    prior_values = priors or {}
    turns, damping, rejecting = cam_from_icrs, 1e-3, used is None
    keep = np.ones(len(stars), bool) if used is None else used
    residual = _residual(stars, vector.camera(), turns)
    for step in range(rounds):
        length = _length(residual, stars)
        scale = _scale(length[keep], stars, len(vector.free), keep)
        if rejecting and step >= 3:
            keep = _kept(stars, length, scale)
        weight = _weights(length, scale, stars, keep)
        normal = _normal(stars, vector, turns, residual, weight, prior_values)
        before = _cost(length, scale, keep, vector, prior_values)
        for _ in range(8):
            turn, move = _solve(normal, damping)
            moved, rotated = vector.moved(move), _turned(turns, turn)
            trial = _residual(stars, moved.camera(), rotated)
            after = _cost(_length(trial, stars), scale, keep, moved, prior_values)
            if after <= before * (1 + 1e-12):
                break
            damping *= DAMPED
        else:
            break
        vector, turns, residual = moved, rotated, trial
        damping = max(damping * EASED, 1e-12)
        if step >= (5 if rejecting else 1) and before - after < DONE * before + SETTLED:
            break
    return _finished(stars, vector, turns, residual, keep, prior_values, rejecting)


def _finished(
    stars: StarStack,
    vector: Vector,
    turns: Array,
    residual: Array,
    keep: NDArray[np.bool_],
    priors: Mapping[str, Prior],
    rejecting: bool,
) -> Adjusted:
    length = _length(residual, stars)
    scale = _scale(length[keep], stars, len(vector.free), keep)
    if rejecting:
        keep = _kept(stars, length, scale)
    freedom = 2 * int(keep.sum()) - 3 * stars.frames - len(vector.free)
    chi2 = float(np.sum(np.minimum(length[keep], HUBER * scale) ** 2)) / max(1, freedom)
    # The stated errors are included with a small weight. They have an effect only if few stars determine the size of
    # the errors.
    spread = float(np.sqrt((chi2 * max(0, freedom) + 20.0) / (max(0, freedom) + 20.0)))
    normal = _normal(stars, vector, turns, residual, np.where(keep, 1 / (stars.sigma_px * spread) ** 2, 0.0), priors)
    covariance, attitudes = _covariances(normal)
    return Adjusted(vector, turns, residual, keep, spread, covariance, attitudes, freedom)


def _residual(stars: StarStack, camera: Camera, turns: Array) -> Array:
    cam = np.einsum("nij,nj->ni", turns[stars.frame], stars.icrs)
    residual = stars.pixels - camera.project(cam)
    return np.where(np.isfinite(residual), residual, 1e6)


def _length(residual: Array, stars: StarStack) -> Array:
    return np.asarray(np.hypot(residual[:, 0], residual[:, 1]) / stars.sigma_px)


def _scale(length: Array, stars: StarStack, parameters: int, keep: NDArray[np.bool_]) -> float:
    """Return the ratio of the typical residual to the stars' stated errors, corrected for the fitted degrees of freedom."""
    if not len(length):
        return 1.0
    freedom = max(2 * int(keep.sum()) - 3 * stars.frames - parameters, 1)
    return max(float(np.median(length)) / RAYLEIGH_MEDIAN * float(np.sqrt(2 * keep.sum() / freedom)), 1e-3)


def _kept(stars: StarStack, length: Array, scale: float) -> NDArray[np.bool_]:
    """Return a mask of the stars within the limit. Each frame keeps at least its two best stars, because the equations
    of its block cannot be solved with fewer."""
    keep = length < REJECT * scale
    short = np.flatnonzero(np.add.reduceat(keep.astype(int), stars.first) < 2)
    for f in short:
        in_frame = np.flatnonzero(stars.frame == f)
        keep[in_frame[np.argsort(length[in_frame])[:2]]] = True
    return np.asarray(keep)


def _weights(length: Array, scale: float, stars: StarStack, keep: NDArray[np.bool_]) -> Array:
    huber = np.minimum(1.0, HUBER * scale / np.maximum(length, 1e-12))
    return np.where(keep, huber / (stars.sigma_px * scale) ** 2, 0.0)


def _cost(length: Array, scale: float, keep: NDArray[np.bool_], vector: Vector, priors: Mapping[str, Prior]) -> float:
    """Return the Huber loss in squared standard deviations, including the priors."""
    return huber_cost(length[keep] / scale) + float(np.sum([(d / s) ** 2 for d, s in _off(vector, priors) if s]))


def huber_cost(scaled: Array) -> float:
    """Return the Huber loss, which is quadratic below the limit and linear above."""
    return float(np.sum(np.where(scaled < HUBER, scaled**2, HUBER * (2 * scaled - HUBER))))


def _off(vector: Vector, priors: Mapping[str, Prior]) -> list[tuple[float, float]]:
    """Return the deviation from the prior and the σ of the prior for each free parameter (both 0 without a prior)."""
    off = []
    for name in vector.free:
        p = priors.get(name)
        if p is None:
            off.append((0.0, 0.0))
        elif name in ("focal_px", "aspect"):
            off.append((float(np.log(vector.values[name] / p.value)), p.sigma / p.value))
        else:
            off.append((vector.values[name] - p.value, p.sigma))
    return off


def _normal(
    stars: StarStack, vector: Vector, turns: Array, residual: Array, weight: Array, priors: Mapping[str, Prior]
) -> _Normal:
    by_turn, by_camera = derivatives(stars, vector, turns)
    weighted = by_turn * weight[:, None, None]
    blocks = np.add.reduceat(np.einsum("nki,nkj->nij", weighted, by_turn), stars.first)
    border = np.add.reduceat(np.einsum("nki,nkp->nip", weighted, by_camera), stars.first)
    turn = np.add.reduceat(np.einsum("nki,nk->ni", weighted, residual), stars.first)
    corner = np.einsum("nkp,n,nkq->pq", by_camera, weight, by_camera)
    move = np.einsum("nkp,n,nk->p", by_camera, weight, residual)
    for k, (off, sigma) in enumerate(_off(vector, priors)):
        if sigma:
            corner[k, k] += sigma**-2
            move[k] -= off * sigma**-2
    return _Normal(blocks, border, corner, turn, move)


def derivatives(stars: StarStack, vector: Vector, turns: Array) -> tuple[Array, Array]:
    """Return the derivatives of the predicted positions with respect to the rotation (n, 2, 3) and the parameters (n,
    2, p). They are zero for positions outside the lens's domain."""
    camera = vector.camera()
    cam = np.einsum("nij,nj->ni", turns[stars.frame], stars.icrs)

    base = camera.project(cam)

    def slope(moved: Array, step: float) -> Array:
        difference = (moved - base) / step
        return np.where(np.isfinite(difference), difference, 0.0)

    by_turn = [
        slope(camera.project(cam @ rotation_from_vector(axis * TURN_STEP_RAD).T), TURN_STEP_RAD) for axis in np.eye(3)
    ]
    steps = difference_steps(vector)
    by_camera = [
        slope(vector.moved(e * h).camera().project(cam), float(h))
        for e, h in zip(np.eye(len(steps)), steps, strict=True)
    ]
    shaped = np.stack(by_camera, axis=-1) if by_camera else np.zeros((len(stars), 2, 0))
    return np.stack(by_turn, axis=-1), shaped


def _solve(normal: _Normal, damping: float) -> tuple[Array, Array]:
    blocks = normal.blocks * (1 + damping * np.eye(3)) + 1e-9 * np.eye(3)
    inverse = np.linalg.inv(blocks)
    corner = normal.corner * (1 + damping * np.eye(len(normal.corner)))
    eliminated = np.einsum("fip,fij,fjq->pq", normal.border, inverse, normal.border)
    right = normal.move - np.einsum("fip,fij,fj->p", normal.border, inverse, normal.turn)
    move = _scaled_solve(corner - eliminated, right)
    turn = np.einsum("fij,fj->fi", inverse, normal.turn - normal.border @ move)
    return turn, move


def _scaled_solve(matrix: Array, right: Array) -> Array:
    if not len(right):
        return right
    size = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    shaped = matrix / np.outer(size, size) + 1e-12 * np.eye(len(size))
    return np.asarray(np.linalg.solve(shaped, right / size) / size)


def _covariances(normal: _Normal) -> tuple[Array, Array]:
    """Return the covariances of the camera and of each attitude. The latter include the error of the camera."""
    inverse = np.linalg.inv(normal.blocks + 1e-9 * np.eye(3))
    schur = normal.corner - np.einsum("fip,fij,fjq->pq", normal.border, inverse, normal.border)
    camera = _scaled_inverse(schur)
    lever = np.einsum("fij,fjp->fip", inverse, normal.border)
    return camera, inverse + np.einsum("fip,pq,fjq->fij", lever, camera, lever)


def _scaled_inverse(matrix: Array) -> Array:
    """Return the inverse. Directions that the data do not determine get a very large variance."""
    if not len(matrix):
        return matrix
    size = np.sqrt(np.maximum(np.diag(matrix), 1e-300))
    values, vectors = np.linalg.eigh(matrix / np.outer(size, size))
    shaped = (vectors / np.maximum(values, 1e-11)) @ vectors.T
    return np.asarray(shaped / np.outer(size, size))


def _turned(turns: Array, vectors: Array) -> Array:
    """Return the (f, 3, 3) attitudes rotated by (f, 3) rotation vectors."""
    vector = np.clip(vectors, -0.3, 0.3)
    half = np.linalg.norm(vector, axis=1, keepdims=True) / 2
    quaternion = np.concatenate([vector * 0.5 * np.sinc(half / np.pi), np.cos(half)], axis=1)
    return np.asarray(matrix_from_quaternion(quaternion) @ turns)

"""Attitude of a body from several heads, weighted by their full covariances, and the test of their agreement.

A head measures the two angles across its boresight several times better than the roll about the boresight, so each
covariance has one large axis. Two heads with different boresights determine all three angles well, because a rotation
about the boresight of the first head is a rotation across the boresight of the second (Moniteq 1983 §6.2).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc

from gss.domain.angles import Array, separation_rad
from gss.domain.errors import BadInput
from gss.domain.rotation import matrix_from_quaternion, quaternion_product, turn_between, turned
from gss.pipeline.track.cameras_together import BodyAttitude

ROUNDS = 20
SETTLED_RAD = 1e-12
BORESIGHT = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class Agreement:
    """Result of a χ² test. ``probability``: probability that heads with correct covariances differ at least this much."""

    chi2: float
    freedom: int
    probability: float


@dataclass(frozen=True)
class FusedAttitude:
    """Weighted mean attitude of several heads. ``agreement`` is None with a single head."""

    quaternion: Array
    covariance_rad2: Array
    agreement: Agreement | None


@dataclass(frozen=True)
class HeadDifference:
    """Difference of two heads: the second relative to the first. ``vector_rad`` (3,): rotation in the body frame from
    the first attitude to the second; ``angle_rad``: length of the vector, with the standard deviation along its
    direction. ``boresight_rad``: measured minus nominal angle between the two boresights, which does not depend on the
    roll of either head."""

    vector_rad: Array
    angle_rad: float
    angle_sigma_rad: float
    boresight_rad: float
    boresight_sigma_rad: float
    agreement: Agreement


def head_covariance(sigma_cross_rad: float, sigma_roll_rad: float) -> Array:
    """Return the (3, 3) covariance in the camera frame, from standard deviations per axis across and about the
    boresight. Raises BadInput if one is not a positive number."""
    sigma = np.array([sigma_cross_rad, sigma_cross_rad, sigma_roll_rad])
    if not (np.isfinite(sigma).all() and (sigma > 0).all()):
        raise BadInput("a standard deviation is not a positive number", expected="> 0", got=str(sigma.tolist()))
    return np.diag(sigma**2)


def in_body(
    quaternion: Array, covariance_rad2: Array, body_from_cam: Array, mounting_rad2: Array | None = None
) -> BodyAttitude:
    """Convert a head's attitude to an attitude of the body. ``quaternion`` (4,): cam_from_icrs; ``covariance_rad2``: in
    the camera frame; ``body_from_cam`` (4,): mounting; ``mounting_rad2`` (3, 3): covariance of the mounting in the body
    frame."""
    turn = matrix_from_quaternion(body_from_cam)
    covariance = turn @ covariance_rad2 @ turn.T
    if mounting_rad2 is not None:
        covariance = covariance + mounting_rad2
    return BodyAttitude(quaternion_product(body_from_cam, quaternion), covariance)


def fuse(heads: Sequence[BodyAttitude]) -> FusedAttitude:
    """Return the mean of attitudes that several heads measured at the same time, weighted by their inverse covariances.
    The mean is iterated until it converges. Raises BadInput without a head."""
    if not heads:
        raise BadInput("no attitude to fuse", expected="at least one head", got="none")
    weights = np.stack([np.linalg.inv(h.covariance_rad2) for h in heads])
    covariance = np.linalg.inv(weights.sum(axis=0))
    measured = np.stack([h.quaternion for h in heads])
    quaternion = measured[int(np.argmax(np.linalg.det(weights)))]
    for _ in range(ROUNDS):
        residual = turn_between(np.broadcast_to(quaternion, measured.shape), measured)
        step = covariance @ np.einsum("nij,nj->i", weights, residual)
        quaternion = turned(quaternion, step)
        if float(np.linalg.norm(step)) < SETTLED_RAD:
            break
    if len(heads) == 1:
        return FusedAttitude(quaternion, covariance, None)
    residual = turn_between(np.broadcast_to(quaternion, measured.shape), measured)
    chi2 = float(np.einsum("ni,nij,nj->", residual, weights, residual))
    return FusedAttitude(quaternion, covariance, _tested(chi2, 3 * (len(heads) - 1)))


def difference(
    first: BodyAttitude, second: BodyAttitude, first_boresight: Array, second_boresight: Array
) -> HeadDifference:
    """Compare two heads. ``first_boresight``, ``second_boresight``: (3,) nominal boresights in the body frame."""
    vector = turn_between(first.quaternion[None], second.quaternion[None])[0]
    covariance = first.covariance_rad2 + second.covariance_rad2
    angle = float(np.linalg.norm(vector))
    variance = float(vector @ covariance @ vector) / angle**2 if angle > 0 else float(np.trace(covariance)) / 3
    # Convert the second head's measured boresight to the body frame of the first head: exp(−[vector]×).
    second_in_first = matrix_from_quaternion(turned(np.array([0.0, 0.0, 0.0, 1.0]), -vector)) @ second_boresight
    nominal = float(separation_rad(first_boresight, second_boresight))
    # A rotation about the normal of the great circle through both boresights changes the angle between them.
    normal = np.cross(first_boresight, second_boresight)
    size = float(np.linalg.norm(normal))
    across = covariance - np.outer(second_boresight, second_boresight @ covariance)
    spread = float(normal @ covariance @ normal) / size**2 if size > 1e-9 else float(np.trace(across)) / 2
    return HeadDifference(
        vector_rad=vector,
        angle_rad=angle,
        angle_sigma_rad=float(np.sqrt(variance)),
        boresight_rad=float(separation_rad(first_boresight, second_in_first)) - nominal,
        boresight_sigma_rad=float(np.sqrt(spread)),
        agreement=_tested(float(vector @ np.linalg.solve(covariance, vector)), 3),
    )


def boresight_of(body_from_cam: Array) -> Array:
    """Return the (3,) boresight, in the body frame, of a head with a (4,) mounting."""
    return np.asarray(matrix_from_quaternion(body_from_cam) @ BORESIGHT)


def _tested(chi2: float, freedom: int) -> Agreement:
    return Agreement(chi2, freedom, float(chdtrc(freedom, chi2)))

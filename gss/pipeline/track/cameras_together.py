"""Body attitude from several cameras. One camera measures two angles well; two cameras at right angles measure all
three (Moniteq 1983 §6.2)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gss.domain.angles import Array
from gss.domain.rotation import quaternion_from_matrix
from gss.pipeline.attitude import covariance_rad2, svd
from gss.pipeline.track.differential import differential_attitude


@dataclass(frozen=True)
class CameraView:
    """Matched stars of one camera: (n, 3) measured directions in the camera frame, (n, 3) directions in ICRS, (n,)
    standard deviations per axis, and the (3, 3) mounting ``body_from_cam``."""

    measured_cam: Array
    reference_icrs: Array
    sigma_rad: Array
    body_from_cam: Array


@dataclass(frozen=True)
class BodyAttitude:
    """Attitude of the body. ``quaternion`` (4,) body_from_icrs; ``covariance_rad2`` (3, 3) of the small rotation vector
    in the body frame."""

    quaternion: Array
    covariance_rad2: Array


def body_attitude(views: Sequence[CameraView], body_from_icrs: Array | None = None) -> BodyAttitude | None:
    """Fit the body attitude to the stars of all cameras, weighted by 1/σ². None if the stars do not determine all three
    axes.

    ``body_from_icrs``: initial attitude of the differential method. Without it, a closed-form solution is computed
    first.
    """
    used = [v for v in views if len(v.measured_cam)]
    if sum(len(v.measured_cam) for v in used) < 2:
        return None
    measured = np.concatenate([v.measured_cam @ v.body_from_cam.T for v in used])
    reference = np.concatenate([v.reference_icrs for v in used])
    sigma = np.concatenate([np.broadcast_to(v.sigma_rad, len(v.measured_cam)) for v in used])
    weights = 1.0 / sigma**2
    start = svd(measured, reference, weights) if body_from_icrs is None else body_from_icrs
    attitude = differential_attitude(measured, reference, start, weights)
    if attitude is None:
        return None
    return BodyAttitude(quaternion_from_matrix(attitude), covariance_rad2(measured, sigma))

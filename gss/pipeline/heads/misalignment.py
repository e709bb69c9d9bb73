"""Misalignment of one head relative to another and its drift, by a Kalman filter over their differences.

State: rotation vector m of the misalignment and its rate of change, in body axes. If the mounting of the first head is
correct, the true mounting of the second head is exp([m]×)·(nominal mounting). Both states follow a slow random walk, so
that the estimate follows changes of temperature.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from gss.domain.angles import ARCSEC_RAD, Array
from gss.domain.errors import BadInput
from gss.domain.rotation import turn_between
from gss.pipeline.track.cameras_together import BodyAttitude

HOUR_S = 3600.0
GATE_CHI2 = 30.7
"""Value of χ² above which a difference is rejected. Its probability is 1e-6 for three degrees of freedom."""
JUMPED_AFTER = 5
"""Number of consecutive rejected differences after which a sudden change of the mounting is assumed and the filter
restarts."""


@dataclass(frozen=True)
class DriftModel:
    """Assumptions before and between measurements. ``drift_sigma_rad_s``: typical drift; ``walk_rad2_s``: variance
    added to the misalignment per second, in addition to the drift; ``drift_walk_rad2_s3``: variance added to the drift
    per second."""

    drift_sigma_rad_s: float = 600 * ARCSEC_RAD / HOUR_S
    walk_rad2_s: float = (1 * ARCSEC_RAD) ** 2 / HOUR_S
    drift_walk_rad2_s3: float = (3 * ARCSEC_RAD / HOUR_S) ** 2 / HOUR_S


USUAL_DRIFT = DriftModel()


@dataclass(frozen=True)
class Misalignment:
    """Estimate of the misalignment at ``time_s``, started at ``began_s``. ``state`` (6,): misalignment (rad) and drift
    (rad/s); ``covariance`` (6, 6). ``samples``: differences used since the last start; ``rejected``: consecutive
    rejected differences; ``restarts``: number of sudden changes of the mounting, not counting a first difference beyond
    the stated uncertainty of the mounting."""

    time_s: float
    state: Array
    covariance: Array
    began_s: float
    samples: int = 0
    rejected: int = 0
    restarts: int = 0

    @property
    def vector_rad(self) -> Array:
        """Return the (3,) misalignment."""
        return self.state[:3]

    @property
    def drift_rad_s(self) -> Array:
        """Return the (3,) drift."""
        return self.state[3:]

    @property
    def sigma_rad(self) -> Array:
        """Return the (3,) standard deviation of the misalignment, without errors that do not average out."""
        return np.sqrt(np.diag(self.covariance)[:3])

    @property
    def drift_sigma_rad_s(self) -> Array:
        """Return the (3,) standard deviation of the drift."""
        return np.sqrt(np.diag(self.covariance)[3:])


def started(time_s: float, mounting_rad2: Array, model: DriftModel = USUAL_DRIFT) -> Misalignment:
    """Return the estimate before the first difference. ``mounting_rad2`` (3, 3): uncertainty of both mountings."""
    covariance = np.zeros((6, 6))
    covariance[:3, :3] = mounting_rad2
    covariance[3:, 3:] = np.eye(3) * model.drift_sigma_rad_s**2
    return Misalignment(time_s, np.zeros(6), covariance, time_s)


def predicted(estimate: Misalignment, time_s: float, model: DriftModel = USUAL_DRIFT) -> Misalignment:
    """Return the estimate at a later time. Raises BadInput for an earlier one."""
    dt = time_s - estimate.time_s
    if dt < 0:
        raise BadInput(
            "the difference is older than the estimate", expected=f"≥ {estimate.time_s:.3f} s", got=f"{time_s:.3f} s"
        )
    step, identity = np.eye(6), np.eye(3)
    step[:3, 3:] = dt * identity
    walk = np.block(
        [
            [
                (model.walk_rad2_s * dt + model.drift_walk_rad2_s3 * dt**3 / 3) * identity,
                model.drift_walk_rad2_s3 * dt**2 / 2 * identity,
            ],
            [model.drift_walk_rad2_s3 * dt**2 / 2 * identity, model.drift_walk_rad2_s3 * dt * identity],
        ]
    )
    covariance = step @ estimate.covariance @ step.T + walk
    return replace(estimate, time_s=time_s, state=step @ estimate.state, covariance=covariance)


def updated(
    estimate: Misalignment,
    time_s: float,
    first: BodyAttitude,
    second: BodyAttitude,
    lasting_rad2: Array,
    model: DriftModel = USUAL_DRIFT,
) -> Misalignment:
    """Return the estimate after another difference. ``first``, ``second``: attitudes of the body by the two heads at
    ``time_s``, with their nominal mountings; ``lasting_rad2`` (3, 3): covariance of errors that do not average out,
    i.e. of the clocks and of constant errors."""
    before = predicted(estimate, time_s, model)
    measured = turn_between(second.quaternion[None], first.quaternion[None])[0]
    noise = first.covariance_rad2 + second.covariance_rad2 + lasting_rad2
    off = measured - before.state[:3]
    expected = before.covariance[:3, :3] + noise
    if float(off @ np.linalg.solve(expected, off)) > GATE_CHI2:
        if before.rejected + 1 < JUMPED_AFTER:
            return replace(before, rejected=before.rejected + 1)
        fresh = started(time_s, noise, model)
        return replace(
            fresh,
            state=np.concatenate([measured, np.zeros(3)]),
            samples=1,
            restarts=before.restarts + (1 if before.samples else 0),
        )
    gain = np.linalg.solve(expected, before.covariance[:3]).T
    keep = np.eye(6)
    keep[:, :3] -= gain
    # Joseph's form keeps the covariance symmetric and positive.
    covariance = keep @ before.covariance @ keep.T + gain @ noise @ gain.T
    state = before.state + gain @ off
    return replace(before, state=state, covariance=covariance, samples=before.samples + 1, rejected=0)

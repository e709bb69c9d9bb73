"""Attitudes of several heads at a common time, from attitudes measured at different times.

Between or shortly after two attitudes of the same head, the body is assumed to rotate at a constant rate. With a single
attitude the rate is unknown. The attitude is then used only if a largest rate is stated, and its uncertainty includes a
rotation at this rate.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gss.domain.angles import Array
from gss.domain.rotation import turn_between, turned
from gss.pipeline.track.cameras_together import BodyAttitude

MAX_STEP_S = 30.0
"""Maximum time between two attitudes from which a rate is computed."""
FURTHEST_AHEAD = 1.0
"""Maximum extrapolation of an attitude, as a multiple of the time between the two attitudes before it."""


@dataclass(frozen=True)
class MeasuredAttitude:
    """One attitude of a head at ``time_s``. ``time_sigma_s``: uncertainty of the time, mostly common to all attitudes
    of the head."""

    time_s: float
    time_sigma_s: float
    attitude: BodyAttitude


@dataclass(frozen=True)
class AttitudeAt:
    """Attitude of a head at a requested time. ``rate_rad_s`` (3,): angular velocity in the body frame, None if unknown.
    ``timing_rad2`` (3, 3): covariance due to the uncertain clock. It is not part of the attitude's covariance, because
    this error does not average out."""

    attitude: BodyAttitude
    rate_rad_s: Array | None
    timing_rad2: Array

    @property
    def with_timing(self) -> BodyAttitude:
        """Return the attitude with the covariance of all errors, including the clock's."""
        return BodyAttitude(self.attitude.quaternion, self.attitude.covariance_rad2 + self.timing_rad2)


def attitude_at(
    series: Sequence[MeasuredAttitude], time_s: float, tolerance_s: float, largest_rate_rad_s: float | None
) -> AttitudeAt | None:
    """Return the head's attitude at a time, from its attitudes in order of time. None if no attitude is within
    ``tolerance_s``, or if the change since the nearest attitude is unknown. ``largest_rate_rad_s``: largest rate of the
    body, None if not stated."""
    near = min(series, key=lambda sample: abs(sample.time_s - time_s), default=None)
    if near is None or abs(near.time_s - time_s) > tolerance_s:
        return None
    pair = _around(series, time_s)
    if pair is not None:
        return _along(*pair, time_s, near.time_sigma_s)
    off_s = time_s - near.time_s
    if largest_rate_rad_s is None:
        if off_s or near.time_sigma_s:
            return None
        largest_rate_rad_s = 0.0
    # The direction of the rate is unknown, so each axis can have the full rate.
    moved = BodyAttitude(
        near.attitude.quaternion, near.attitude.covariance_rad2 + (largest_rate_rad_s * off_s) ** 2 * np.eye(3)
    )
    return AttitudeAt(moved, None, (largest_rate_rad_s * near.time_sigma_s) ** 2 * np.eye(3))


def _around(series: Sequence[MeasuredAttitude], time_s: float) -> tuple[MeasuredAttitude, MeasuredAttitude] | None:
    """Return the two attitudes before and after the time. If one is missing, return the last two before the time or the
    first two after it. Return None if the two attitudes are too far apart."""
    if len(series) < 2:
        return None
    second = next((k for k, sample in enumerate(series) if sample.time_s >= time_s), len(series) - 1)
    first, last = series[max(second, 1) - 1], series[max(second, 1)]
    step_s = last.time_s - first.time_s
    outside_s = max(first.time_s - time_s, time_s - last.time_s, 0.0)
    return (first, last) if 0 < step_s <= MAX_STEP_S and outside_s <= FURTHEST_AHEAD * step_s else None


def _along(first: MeasuredAttitude, last: MeasuredAttitude, time_s: float, sigma_s: float) -> AttitudeAt:
    step_s = last.time_s - first.time_s
    part = (time_s - first.time_s) / step_s
    turn = turn_between(first.attitude.quaternion[None], last.attitude.quaternion[None])[0]
    rate = -turn / step_s
    covariance = (1 - part) ** 2 * first.attitude.covariance_rad2 + part**2 * last.attitude.covariance_rad2
    interpolated = BodyAttitude(turned(first.attitude.quaternion, part * turn), covariance)
    return AttitudeAt(interpolated, rate, sigma_s**2 * np.outer(rate, rate))

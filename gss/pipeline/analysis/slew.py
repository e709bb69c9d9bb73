"""Comparison of rates measured from frame to frame with the commanded rate (Erlank 2013 §6.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.domain.rotation import turn_between
from gss.pipeline.analysis.series import FEWEST, AttitudeSeries, check_series, usable
from gss.pipeline.calibration.advice import Advice
from gss.pipeline.calibration.robust import robust_sigma

MAX_TURN_RAD = 3.0
OFF_SIGMAS = 5.0
OFF_SHARE = 0.02
FAR_OFF_SHARE = 0.2
MIN_AGREE = 0.9  # length of the mean unit axis of the intervals: 1 if all axes are equal, near 0 for random axes
OVER_CLAIM = 10.0


@dataclass(frozen=True)
class SlewTest:
    """Result of a slew test over m intervals between frames, without those over which the commanded rotation is too
    large to measure. ``times_s`` (m,) midpoints; ``rate_rad_s`` (m, 3) in camera axes, ``speed_rad_s`` (m,) its
    magnitude. ``commanded_rad_s``: commanded speed. ``mean_speed_rad_s`` ± ``mean_sigma_rad_s``: total rotation by
    total time; ``axis`` (3,) mean unit vector; ``sigma_rad_s`` (3,): scatter along this axis and along two axes
    perpendicular to it; ``claimed_rad_s``: rms σ of one rate, computed from the covariances that the chain reports."""

    times_s: Array
    rate_rad_s: Array
    speed_rad_s: Array
    commanded_rad_s: float
    mean_speed_rad_s: float
    mean_sigma_rad_s: float
    axis: Array
    sigma_rad_s: Array
    claimed_rad_s: float
    solved_share: float
    mean_matches: float
    warnings: tuple[Advice, ...]

    @property
    def ratio(self) -> float:
        """Return the ratio of measured to commanded speed."""
        return self.mean_speed_rad_s / self.commanded_rad_s


def slew_test(series: AttitudeSeries, commanded_rad_s: float) -> SlewTest:
    """Analyse a run at a constant rate ``commanded_rad_s`` > 0. Raises BadInput with fewer than five attitudes."""
    if not (np.isfinite(commanded_rad_s) and commanded_rad_s > 0):
        got = f"{np.degrees(commanded_rad_s):g}°/s"
        raise BadInput(
            "the commanded rate of the slew is out of range",
            expected="above 0°/s",
            got=got,
            hint="use the fixed test for a camera at rest",
        )
    good = usable(series, "a slew test")
    start = np.flatnonzero(commanded_rad_s * np.diff(good.times_s) <= MAX_TURN_RAD)
    if len(start) < FEWEST - 1:
        raise BadInput(
            "the camera rotates too far between two frames to determine the direction",
            expected=f"{FEWEST - 1} intervals with a rotation under {np.degrees(MAX_TURN_RAD):.0f}°",
            got=str(len(start)),
        )
    steps_s = good.times_s[start + 1] - good.times_s[start]
    rate = -turn_between(good.quaternion[start], good.quaternion[start + 1]) / steps_s[:, None]
    speed = np.linalg.norm(rate, axis=1)
    # With the steps as weights, the errors of all attitudes but the first and the last cancel.
    mean = np.average(rate, axis=0, weights=steps_s)
    mean_rate = float(np.linalg.norm(mean))
    axis = mean / max(mean_rate, 1e-300)
    sigma = _scatter(rate, axis)
    covariance = (good.covariance_rad2[start] + good.covariance_rad2[start + 1]) / steps_s[:, None, None] ** 2
    claimed = float(np.sqrt(np.mean(np.trace(covariance, axis1=1, axis2=2)) / 3))
    mean_sigma = _mean_sigma((rate @ axis - mean_rate) * steps_s) / float(steps_s.sum())
    warnings = [
        *check_series(series),
        *_advice(mean_rate, mean_sigma, commanded_rad_s, axis, rate),
        *_doubts(rate, sigma, claimed),
    ]
    return SlewTest(
        (good.times_s[start] + good.times_s[start + 1]) / 2,
        rate,
        speed,
        commanded_rad_s,
        mean_rate,
        mean_sigma,
        axis,
        sigma,
        claimed,
        len(good) / len(series),
        float(good.matches.mean()),
        tuple(warnings),
    )


def _scatter(rate: Array, axis: Array) -> Array:
    """Return the (3,) standard deviations along the axis and along two directions across it."""
    helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
    first = np.cross(axis, helper)
    first /= np.linalg.norm(first)
    frame = np.stack([axis, first, np.cross(axis, first)])
    return np.asarray((rate @ frame.T).std(axis=0, ddof=1))


def _mean_sigma(deviation_rad: Array) -> float:
    """Return the σ of the total rotation, from the (m,) deviations of the intervals from the mean rate.

    The mean square rotation over l intervals is 2 σ² + l q for attitude noise σ and independent rate errors with variance q
    per interval. It is measured for one interval and for a quarter of the run, and extrapolated to the whole run.
    """
    m = len(deviation_rad)
    lag = max(2, m // 4)
    angle = np.concatenate([[0.0], np.cumsum(deviation_rad)])
    single, longer = (float(np.mean((angle[k:] - angle[:-k]) ** 2)) for k in (1, lag))
    # The deviations add up to zero over the run, so the rate errors give l (1 − l/m) q instead of l q.
    rate_part = max(0.0, (longer - single) / (lag * (1 - lag / m) - (1 - 1 / m)))
    return float(np.sqrt(single + (m - 1 + 1 / m) * rate_part))


def _advice(measured_rate: float, sigma: float, commanded: float, axis: Array, rate: Array) -> list[Advice]:
    advice: list[Advice] = []
    speed = float(np.median(np.linalg.norm(rate, axis=1)))
    is_far_off = max(abs(measured_rate - commanded), abs(speed - commanded)) > FAR_OFF_SHARE * commanded
    if is_far_off:
        text = (
            f"measured {np.degrees(measured_rate):.5g}°/s along the mean axis, {np.degrees(speed):.5g}°/s from frame to frame, "
            f"where {np.degrees(commanded):.5g}°/s were commanded"
        )
        hint = "this is not a run at the commanded rate: check frames, times and command"
        advice.append(Advice("rate", text, hint, severe=True))
    elif abs(measured_rate - commanded) > max(OFF_SIGMAS * sigma, OFF_SHARE * commanded):
        text = f"measured {np.degrees(measured_rate):.5g}°/s where {np.degrees(commanded):.5g}°/s were commanded"
        advice.append(
            Advice(
                "rate",
                text,
                "check the rate of the mount, the times of the frames, and whether the rotation of the Earth is included",
            )
        )
    along = rate @ axis
    spread = robust_sigma(along)
    changing = float(np.ptp(np.polyval(np.polyfit(np.arange(len(along)), along, 1), [0, len(along) - 1])))
    if len(along) >= 10 and changing > max(6 * spread / np.sqrt(len(along)) * 3.5, 0.05 * commanded):
        advice.append(Advice("unsteady", "the rate changes over the run", "exclude the start and the end of the slew"))
    return advice


def _doubts(rate: Array, sigma: Array, claimed: float) -> list[Advice]:
    """Return warnings if the attitudes do not fit a constant rotation."""
    advice: list[Advice] = []
    speed = np.linalg.norm(rate, axis=1)
    moving = rate[speed > 0] / speed[speed > 0, None]
    agree = float(np.linalg.norm(moving.mean(axis=0))) if len(moving) else 0.0
    if agree < MIN_AGREE:
        text = f"the intervals turn about different axes: their mean unit axis is {agree:.2f} long, one axis gives 1"
        advice.append(Advice("axes", text, "use frames of one slew in the order of exposure", severe=True))
    scatter = float(np.sqrt(np.mean(sigma**2)))
    if scatter > OVER_CLAIM * claimed > 0:
        text = f"the scatter of the rates is {scatter / claimed:.0f} times the value expected from the covariances"
        advice.append(
            Advice("scatter", text, "check for wrong attitudes, wrong times or vibration of the mount", severe=True)
        )
    return advice

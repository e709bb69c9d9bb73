"""Relative mounting of two cameras on one body, and its stability."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss.domain.angles import Array
from gss.domain.errors import BadInput
from gss.domain.rotation import matrix_from_quaternion, quaternion_inverse, quaternion_product, turn_between, turned
from gss.pipeline.analysis.series import FEWEST, AttitudeSeries
from gss.pipeline.analysis.steady import AxisFigures, axis_figures, drift_limit, slope_sigma
from gss.pipeline.calibration.advice import Advice

APART_S = 0.05
"""Two frames are simultaneous if their times differ by at most this time or by at most a fortieth of the median
step."""
AXES = ("x", "y", "z")
MEAN_PARAMETERS = 1


@dataclass(frozen=True)
class Consistency:
    """Relative mounting of two cameras. ``second_from_first`` (4,): mean relative mounting. ``times_s`` (m,);
    ``deviation_rad`` (m, 3) from the mean, in the second camera's axes; ``axes``: statistics of the deviations, with
    ``claimed_rad`` from both cameras' covariances. ``chi``: ratio of the measured rms to the claimed rms; it is 1 if
    the covariances are realistic."""

    second_from_first: Array
    times_s: Array
    deviation_rad: Array
    axes: tuple[AxisFigures, ...]
    chi: float
    pairs: int
    warnings: tuple[Advice, ...]


def two_cameras(first: AttitudeSeries, second: AttitudeSeries) -> Consistency:
    """Compare frames that both cameras took at the same times. Raises BadInput with fewer than five pairs."""
    a, b = _together(first.only(first.solved), second.only(second.solved))
    mounting = quaternion_product(b.quaternion, quaternion_inverse(a.quaternion))
    mean = mounting[len(mounting) // 2]
    for _ in range(10):
        mean = turned(mean, turn_between(np.broadcast_to(mean, mounting.shape), mounting).mean(axis=0))
    deviation = turn_between(np.broadcast_to(mean, mounting.shape), mounting)
    rotation = np.stack([matrix_from_quaternion(q) for q in mounting])
    covariance = b.covariance_rad2 + rotation @ a.covariance_rad2 @ np.swapaxes(rotation, 1, 2)
    claimed = np.sqrt(np.mean(np.diagonal(covariance, axis1=1, axis2=2), axis=0))
    at_s = a.times_s - a.times_s.mean()
    drift = np.array([np.polyfit(at_s, deviation[:, k], 1)[0] for k in range(3)])
    drift_sigma = slope_sigma(deviation - np.outer(at_s, drift), at_s)
    axes = axis_figures(AXES, deviation, MEAN_PARAMETERS, claimed, drift, drift_sigma)
    chi = float(np.sqrt(np.mean([(x.sigma_rad / x.claimed_rad) ** 2 for x in axes])))
    advice: list[Advice] = []
    for x in axes:
        if abs(x.drift_rad_s) > drift_limit(len(a)) * x.drift_sigma_rad_s:
            text = f"{x.name}: the mounting drifts by {np.degrees(x.drift_rad_s) * 3600 * 3600:.3g}″ an hour"
            advice.append(
                Advice("drift", text, "check for thermal bending of the structure or a drift between the clocks")
            )
    if np.isfinite(chi) and chi > 1.5:
        text = f"the difference is {chi:.1f} times the value expected from the covariances"
        advice.append(Advice("covariance", text, "calibrate both cameras; covariances do not include slow errors"))
    return Consistency(mean, a.times_s, deviation, axes, chi, len(a), tuple(advice))


def _together(a: AttitudeSeries, b: AttitudeSeries) -> tuple[AttitudeSeries, AttitudeSeries]:
    if not len(a) or not len(b):
        raise BadInput("one camera has no attitude", expected="solved frames of both", got=f"{len(a)} and {len(b)}")
    usual = float(np.median(np.diff(a.times_s))) if len(a) > 1 else 0.0
    nearest = np.abs(a.times_s[:, None] - b.times_s[None, :])
    best = nearest.argmin(axis=1)
    fit = nearest[np.arange(len(a)), best] <= max(APART_S, usual / 40)
    if np.count_nonzero(fit) < FEWEST:
        raise BadInput(
            "too few frames were taken together",
            expected=f"{FEWEST} pairs within {max(APART_S, usual / 40):.3g} s",
            got=str(int(np.count_nonzero(fit))),
            hint="use the same clock for both cameras",
        )
    index = np.flatnonzero(fit)
    return a.only(index), b.only(best[index])

"""Accuracy of a camera that rotates at a constant rate or is at rest. A constant rotation is fitted to the attitudes,
and the residuals are the noise (Erlank 2013 §6.1).

A camera fixed to the Earth rotates once per sidereal day about the celestial pole; a camera fixed to the sky does not
rotate. Both use the same fit: C(t) = exp(−[ω·t]×)·C₀ with a constant ω in camera axes.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import gammaincinv, stdtrit

from gss.domain.angles import Array
from gss.domain.frames import ra_dec_roll_rad
from gss.domain.rotation import matrix_from_quaternion, turn_between, turned
from gss.pipeline.analysis.series import AttitudeSeries, check_series, usable
from gss.pipeline.calibration.advice import Advice
from gss.pipeline.calibration.robust import robust_sigma

SIDEREAL_RAD_S = 7.2921158553e-5
"""Rotation rate of the Earth relative to the stars. Precession is neglected, because it is slower by a factor of
10⁷."""
STRAY_SIGMAS = 5.0
ROUNDS = 6
FREEDOM = 6
LINE_PARAMETERS = 2
JUMP_SIGMAS = 6.0
DRIFT_SIGMAS, FALSE_DRIFT = 5.0, 1e-4
"""Minimum ratio of a significant slope to its σ, and the largest probability of reporting a slope where there is none.
The latter determines the ratio if there are few samples."""
CONFIDENCE = 0.95
BODY_AXES = ("across, x", "across, y", "about")
SKY_AXES = ("RA · cos Dec", "Dec", "rotation")
WANDER = 1.5
"""Ratio of the scatter over the whole run to the frame-to-frame scatter above which a warning reports slow errors."""


@dataclass(frozen=True)
class AxisFigures:
    """Statistics of one angle. ``sigma_rad``: standard deviation from the fitted model, with its 95 % interval
    ``low_rad``, ``high_rad`` (frames assumed independent); ``noise_rad``: frame-to-frame noise (NEA); ``claimed_rad``:
    rms of the σ that the chain reports, NaN if the chain reports no σ; ``drift_rad_s``, ``drift_sigma_rad_s``: slope of
    the fitted line and its σ, for the axis RA · cos Dec in RA."""

    name: str
    sigma_rad: float
    low_rad: float
    high_rad: float
    noise_rad: float
    claimed_rad: float
    drift_rad_s: float
    drift_sigma_rad_s: float


@dataclass(frozen=True)
class SteadyTest:
    """Result of a test at constant rate. ``body``: statistics in camera axes; ``sky``: in the axes of Erlank 2013 Table
    6.1. ``rate_icrs_rad_s`` (3,): fitted rate of the camera, with ``rate_sigma_rad_s`` per axis;
    ``expected_icrs_rad_s``: expected rate. ``deviation_rad`` (n, 3) in camera axes and ``sky_deviation_rad`` (n, 3),
    rows of NaN without an attitude; ``strays``: (n,) outliers excluded from the figures."""

    body: tuple[AxisFigures, ...]
    sky: tuple[AxisFigures, ...]
    rate_icrs_rad_s: Array
    rate_sigma_rad_s: Array
    expected_icrs_rad_s: Array
    deviation_rad: Array
    sky_deviation_rad: Array
    strays: NDArray[np.bool_]
    frames: int
    solved: int
    span_s: float
    warnings: tuple[Advice, ...]


def earth_fixed(series: AttitudeSeries) -> SteadyTest:
    """Analyse a camera fixed to the Earth, which rotates by 15.041″/s about the pole. Raises BadInput with fewer than five
    attitudes."""
    return _steady(series, np.array([0.0, 0.0, SIDEREAL_RAD_S]), "the Earth")


def celestial_fixed(series: AttitudeSeries) -> SteadyTest:
    """Analyse a camera on a tracking telescope mount, which should not rotate relative to the sky."""
    return _steady(series, np.zeros(3), "the sky")


def _steady(series: AttitudeSeries, expected: Array, fixed_to: str) -> SteadyTest:
    good = usable(series, f"a test fixed to {fixed_to}")
    at_s = good.times_s - good.times_s.mean()
    start, rate, keep = _fit(good.quaternion, at_s)
    model = turned(start, -rate * at_s[:, None])
    deviation = turn_between(model, good.quaternion)
    middle = matrix_from_quaternion(start)
    rate_sigma = slope_sigma(deviation[keep], at_s[keep])
    angles, cos_dec = _sky_angles(good)
    line = np.stack([np.polyval(np.polyfit(at_s[keep], angles[keep, k], 1), at_s) for k in range(3)], axis=1)
    # The drift of the first axis is given in RA.
    per_angle = np.array([1 / cos_dec, 1.0, 1.0])
    drift = np.array([np.polyfit(at_s[keep], angles[keep, k], 1)[0] for k in range(3)]) * per_angle
    sky = angles - line
    claimed = np.sqrt(np.mean(np.diagonal(good.covariance_rad2[keep], axis1=1, axis2=2), axis=0))
    body_figures = axis_figures(BODY_AXES, deviation[keep], LINE_PARAMETERS, claimed, -rate, rate_sigma)
    sky_sigma = slope_sigma(sky[keep], at_s[keep]) * per_angle
    sky_figures = axis_figures(SKY_AXES, sky[keep], LINE_PARAMETERS, np.full(3, np.nan), drift, sky_sigma)
    slope = middle.T @ rate
    warnings = (*check_series(series), *_warnings(slope, rate_sigma, expected, good, deviation, keep, body_figures))
    n, solved = len(series), series.solved
    return SteadyTest(
        body_figures,
        sky_figures,
        slope,
        np.sqrt((middle.T**2) @ rate_sigma**2),
        expected,
        _spread(deviation, solved, n),
        _spread(sky, solved, n),
        np.asarray(_spread_mask(~keep, solved, n)),
        n,
        len(good),
        float(np.ptp(series.times_s)),
        warnings,
    )


def _fit(quaternion: Array, at_s: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Return (quaternion at time 0, rate in camera axes, mask of frames used), by Gauss–Newton with iterative outlier rejection."""
    k = len(at_s) // 2
    start, keep = quaternion[k], np.ones(len(at_s), bool)
    steps = turn_between(quaternion[:-1], quaternion[1:]) / np.diff(at_s)[:, None]
    rate = -np.median(steps, axis=0)
    start = turned(start, np.asarray(rate * at_s[k]))
    for _ in range(ROUNDS):
        model = turned(start, -rate * at_s[:, None])
        off = turn_between(model, quaternion)
        design = _design(start, rate, at_s, model)
        change = np.asarray(np.linalg.lstsq(design[keep].reshape(-1, FREEDOM), off[keep].ravel(), rcond=None)[0], float)
        start, rate = turned(start, change[:3]), rate + change[3:]
        residual = turn_between(turned(start, -rate * at_s[:, None]), quaternion)
        spread = np.array([robust_sigma(residual[keep, a]) for a in range(3)])
        keep = (np.abs(residual) <= STRAY_SIGMAS * np.maximum(spread, 1e-12)).all(axis=1)
        if keep.sum() < FREEDOM // 3 + 1:
            keep = np.ones(len(at_s), bool)
    return start, rate, keep


def _design(start: Array, rate: Array, at_s: Array, model: Array) -> Array:
    """Return the (n, 3, 6) derivatives of the deviations with respect to the initial rotation and the rate, from finite
    differences."""
    columns = []
    for p in range(FREEDOM):
        step: Array = np.zeros(3)
        step[p % 3] = 1e-6 if p < 3 else 1e-6 / max(float(np.abs(at_s).max()), 1.0)
        moved = (
            turned(turned(start, step), -rate * at_s[:, None])
            if p < 3
            else turned(start, -(rate + step) * at_s[:, None])
        )
        columns.append(turn_between(model, moved) / step[p % 3])
    return np.stack(columns, axis=-1)


def _sky_angles(good: AttitudeSeries) -> tuple[Array, float]:
    """Return (n, 3) RA·cos Dec, Dec and rotation as smooth functions of time, and the cosine of the mean Dec."""
    angles = np.array([ra_dec_roll_rad(matrix_from_quaternion(q)) for q in good.quaternion])
    angles = np.unwrap(angles, axis=0)
    cos_dec = float(np.cos(angles[:, 1].mean()))
    return angles * np.array([cos_dec, 1.0, 1.0]), cos_dec


def _sigma(deviation: Array, parameters: int) -> Array:
    return np.asarray(np.sqrt(np.sum(deviation**2, axis=0) / (len(deviation) - parameters)))


def slope_sigma(residual: Array, at_s: Array) -> Array:
    """Return the (3,) σ of the slopes of three fitted lines, from their (n, 3) residuals at times ``at_s``."""
    return np.asarray(_sigma(residual, LINE_PARAMETERS) / np.sqrt(np.sum((at_s - at_s.mean()) ** 2)))


def drift_limit(samples: int) -> float:
    """Return the ratio of a slope to its σ above which it is significant, for a line fitted to this number of samples
    (Student's distribution)."""
    return max(DRIFT_SIGMAS, -float(stdtrit(samples - LINE_PARAMETERS, FALSE_DRIFT / 2)))


def axis_figures(
    names: tuple[str, ...], deviation: Array, parameters: int, claimed: Array, drift: Array, drift_sigma: Array
) -> tuple[AxisFigures, ...]:
    """Compute the statistics of (n, 3) deviations from a model with this number of fitted ``parameters`` per axis.
    ``claimed``, ``drift``, ``drift_sigma``: (3,), see :class:`AxisFigures`."""
    sigma, freedom = _sigma(deviation, parameters), len(deviation) - parameters
    # The quantile of χ² is twice the inverse of the incomplete gamma function.
    low, high = (
        np.sqrt(freedom / (2 * gammaincinv(freedom / 2, q))) for q in ((1 + CONFIDENCE) / 2, (1 - CONFIDENCE) / 2)
    )
    noise = np.sqrt(np.mean(np.diff(deviation, axis=0) ** 2, axis=0) / 2)
    return tuple(
        AxisFigures(
            name,
            float(sigma[k]),
            float(sigma[k] * low),
            float(sigma[k] * high),
            float(noise[k]),
            float(claimed[k]),
            float(drift[k]),
            float(drift_sigma[k]),
        )
        for k, name in enumerate(names)
    )


def _warnings(
    rate: Array,
    rate_sigma: Array,
    expected: Array,
    good: AttitudeSeries,
    deviation: Array,
    keep: NDArray[np.bool_],
    body: tuple[AxisFigures, ...],
) -> list[Advice]:
    advice: list[Advice] = []
    off = float(np.linalg.norm(rate - expected))
    limit = drift_limit(int(np.count_nonzero(keep)))
    if off > max(limit * float(np.linalg.norm(rate_sigma)), 0.02 * SIDEREAL_RAD_S):
        text = f"the camera turned by {np.degrees(off) * 3600:.3g}″/s more than expected"
        hint = "check for a moving mount, an active drive or a wrong clock"
        advice.append(Advice("moved", text, hint, off > 0.2 * SIDEREAL_RAD_S))
    jumps = _jumps(good.times_s, deviation)
    if jumps:
        hint = "look for a shock to the mount or a jump of the clock at that frame; analyse both parts separately"
        advice.append(Advice("jump", f"jumps of the attitude from one level to another: {jumps}", hint))
    strays = int(np.count_nonzero(~keep))
    if strays:
        advice.append(Advice("strays", f"outliers excluded: {strays} of {len(keep)} attitudes", "check these frames"))
    wander = [a.name for a in body if a.sigma_rad > WANDER * a.noise_rad]
    if wander:
        text = f"{', '.join(wander)}: scatter over the run is far above that from frame to frame"
        hint = "check for slow errors: calibration, stars that enter or leave the field, or a creeping mount"
        advice.append(Advice("wander", text, hint))
    return advice


def _jumps(times_s: Array, deviation: Array) -> int:
    """Count steps between two levels. A step is a time at which the medians of the five frames before and after differ
    by far more than the noise."""
    half = 5
    if len(times_s) < 4 * half:
        return 0
    noise = np.maximum(np.array([robust_sigma(np.diff(deviation[:, k])) for k in range(3)]) / np.sqrt(2), 1e-12)
    before = np.stack([np.median(deviation[k - half : k], axis=0) for k in range(half, len(times_s) - half)])
    after = np.stack([np.median(deviation[k : k + half], axis=0) for k in range(half, len(times_s) - half)])
    high = (np.abs(after - before) > JUMP_SIGMAS * noise).any(axis=1)
    starts = np.flatnonzero(high & ~np.r_[False, high[:-1]])
    return len(starts)


def _spread(values: Array, solved: NDArray[np.bool_], n: int) -> Array:
    out = np.full((n, 3), np.nan)
    out[solved] = values
    return out


def _spread_mask(values: NDArray[np.bool_], solved: NDArray[np.bool_], n: int) -> NDArray[np.bool_]:
    out = np.zeros(n, bool)
    out[solved] = values
    return out

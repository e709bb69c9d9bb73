"""Errors against a reference attitude: a second head on the same body, or the attitude of a simulation.

The rotation from the reference is the sum of a constant bias and the effects of temperature, a date error and
uncorrected aberration. All terms are fitted together to separate them. A term is fitted only if the data vary enough to
determine it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.rotation import matrix_from_quaternion, quaternion_inverse, quaternion_product, turn_between
from gss.pipeline.analysis.series import AttitudeSeries
from gss.pipeline.analysis.two_cameras import two_cameras
from gss.pipeline.calibration.robust import fit_linear, robust_sigma
from gss.pipeline.sheet.rows import interval, resampled

MIN_SPAN_K = 2.0
MIN_RATE_RAD_S = float(np.radians(0.02))
MIN_ABERRATION_RAD = float(np.radians(1.0 / 3600))
MIN_DRIFT_S = 3600.0
BLOCKS, MIN_BLOCKS = 20, 8
DAY_S = 86_400.0
WEIGHT_ROUNDS = 4
MAX_STEPS = 2.5  # longest interval of a rate, in median steps: one lost frame, with jitter of the times


@dataclass(frozen=True)
class Fitted:
    """Fitted quantity with its 95 % interval; scalars, or (3,) per camera axis."""

    value: Array
    low: Array
    high: Array


@dataclass(frozen=True)
class ReferenceErrors:
    """Errors of a camera relative to a reference. ``bias``: constant rotation, rad, relative to the ``expected``
    mounting, None if the mounting is unknown. ``drift``: rad per day. ``thermal``: rad/K. ``date_s``: time from the
    stated time to the measurement. ``aberration``: share of the aberration that was not corrected, from 0 to 1. A term
    is None if the data do not vary enough to determine it. ``rest_rad`` (m, 3): residual rotations, NaN if a date error is
    fitted and the rate of the frame is unknown; ``pairs``: number of the other rows, which were fitted."""

    bias: Fitted | None
    drift: Fitted | None
    thermal: Fitted | None
    date_s: Fitted | None
    aberration: Fitted | None
    span_k: float
    middle_c: float
    rate_rad_s: float
    rest_rad: Array
    times_s: Array
    temperature_c: Array
    pairs: int


@dataclass(frozen=True)
class ReferenceInput:
    """Input of the comparison. ``camera``: attitudes under test; ``reference``: attitudes of the reference. ``block``
    (n,): frames with equal labels have their stars at nearly the same pixels. ``expected`` (4,): camera_from_reference
    from ground alignment, None if unknown. ``temperature_c`` (n,), ``velocity_c`` (n, 3): at the camera's times, None
    if unknown. ``true_reference``: True if the reference has no aberration error, because it is not a head with the
    same processing."""

    camera: AttitudeSeries
    reference: AttitudeSeries
    block: NDArray[np.intp]
    expected: Array | None = None
    temperature_c: Array | None = None
    velocity_c: Array | None = None
    true_reference: bool = False


def reference_errors(data: ReferenceInput, rng: np.random.Generator) -> ReferenceErrors:
    """Fit all terms. Raises BadInput with fewer than five pairs."""
    pairs = two_cameras(data.reference, data.camera)
    index = np.searchsorted(data.camera.times_s, pairs.times_s - 1e-9)
    index = np.clip(_nearest(data.camera.times_s, pairs.times_s, index), 0, len(data.camera) - 1)
    camera, expected = data.camera.only(index), data.expected
    mounting = pairs.second_from_first if expected is None else expected
    reference = _at(data.reference, pairs.times_s)
    off = turn_between(
        np.broadcast_to(mounting, camera.quaternion.shape),
        quaternion_product(camera.quaternion, quaternion_inverse(reference)),
    )
    columns: list[Array] = [_each_axis(np.ones(len(index)))]
    names = ["bias"]
    clock = camera.times_s - camera.times_s.mean()
    if np.ptp(clock) > MIN_DRIFT_S:
        columns.append(_each_axis(clock / DAY_S))
        names.append("drift")
    temperature = np.full(len(index), np.nan) if data.temperature_c is None else data.temperature_c[index]
    span_k = float(np.ptp(temperature)) if np.isfinite(temperature).all() else 0.0
    middle_c = float(temperature.mean()) if span_k else float("nan")
    if span_k >= MIN_SPAN_K:
        columns.append(_each_axis(temperature - middle_c))
        names.append("thermal")
    rate = _rates(camera)
    if float(np.nanmax(np.linalg.norm(rate - np.nanmean(rate, axis=0), axis=1))) >= MIN_RATE_RAD_S:
        columns.append(-rate[:, :, None])
        names.append("date")
    if data.velocity_c is not None:
        shift = _aberration(camera.quaternion, data.velocity_c[index])
        if not data.true_reference:
            turn = matrix_from_quaternion(mounting)
            shift = shift - _aberration(reference, data.velocity_c[index]) @ turn.T
        if float(np.linalg.norm(shift - shift.mean(axis=0), axis=1).max()) >= MIN_ABERRATION_RAD:
            columns.append(shift[:, :, None])
            names.append("aberration")
    blocks = data.block[index]
    if len(np.unique(blocks)) < MIN_BLOCKS:
        blocks = np.arange(len(index), dtype=np.intp) * min(BLOCKS, len(index)) // len(index)
    fitted, residual = _fitted(np.concatenate(columns, axis=2), off, names, [c.shape[2] for c in columns], blocks, rng)
    return ReferenceErrors(
        fitted["bias"] if expected is not None else None,
        fitted.get("drift"),
        fitted.get("thermal"),
        fitted.get("date"),
        fitted.get("aberration"),
        span_k,
        middle_c,
        float(np.nanmax(np.linalg.norm(rate, axis=1))),
        residual,
        camera.times_s,
        temperature,
        int(np.isfinite(residual).all(axis=1).sum()),
    )


def _fitted(
    design: Array,
    off: Array,
    names: list[str],
    widths: list[int],
    blocks: NDArray[np.intp],
    rng: np.random.Generator,
) -> tuple[dict[str, Fitted], Array]:
    """Fit (m, 3, p) columns to (m, 3) rotations, without the rows that have NaN. Returns the terms by name and the residual
    rotations."""
    all_design, all_off = design, off
    known = np.isfinite(design).all(axis=(1, 2))
    design, off, blocks, p = design[known], off[known], blocks[known], design.shape[2]
    # The error about the boresight is many times larger than the error across it. Therefore each axis is weighted by
    # its scatter.
    residual, good = off, np.ones(off.shape, bool)
    for _ in range(WEIGHT_ROUNDS):
        scale = np.array([max(robust_sigma(residual[:, k]), 1e-12) for k in range(3)])
        fit = fit_linear((design / scale[None, :, None]).reshape(-1, p), (off / scale).ravel())
        residual, good = off - design @ fit.coefficients, fit.used.reshape(off.shape)
    design_w, off_w = design / scale[None, :, None] * good[:, :, None], off / scale * good

    def once(index: NDArray[np.intp]) -> Array:
        rows, data = design_w[index].reshape(-1, p), off_w[index].ravel()
        size = np.maximum(np.linalg.norm(rows, axis=0), 1e-300)
        return np.asarray(np.linalg.lstsq(rows / size, data, rcond=1e-9)[0] / size)

    best = once(np.arange(len(off), dtype=np.intp))
    low, high = interval(resampled(blocks, once, rng))
    starts = np.cumsum([0, *widths])
    fitted = {n: Fitted(best[a:b], low[a:b], high[a:b]) for n, a, b in zip(names, starts, starts[1:], strict=False)}
    return fitted, np.asarray(all_off - all_design @ best)


def _each_axis(values: Array) -> Array:
    """Return (m, 3, 3) columns that act on each axis separately."""
    return np.asarray(values[:, None, None] * np.eye(3))


def _nearest(times_s: Array, at_s: Array, right: NDArray[np.intp]) -> NDArray[np.intp]:
    left = np.clip(right - 1, 0, len(times_s) - 1)
    right = np.clip(right, 0, len(times_s) - 1)
    return np.where(np.abs(times_s[left] - at_s) < np.abs(times_s[right] - at_s), left, right)


def _at(series: AttitudeSeries, times_s: Array) -> Array:
    """Return the (m, 4) solved attitudes of the series nearest to these times."""
    good = series.only(series.solved)
    index = _nearest(good.times_s, times_s, np.searchsorted(good.times_s, times_s))
    return np.asarray(good.quaternion[index])


def _rates(series: AttitudeSeries) -> Array:
    """Return the (m, 3) angular velocities in camera axes, from the adjacent attitudes that are near in time; NaN if
    none is."""
    q, t = series.quaternion, series.times_s
    step = np.diff(t)
    near = step <= MAX_STEPS * float(np.median(step))
    index = np.arange(len(t))
    before, after = index - np.r_[False, near], index + np.r_[near, False]
    span = t[after] - t[before]
    return -turn_between(q[before], q[after]) / np.where(span > 0, span, np.nan)[:, None]


def _aberration(quaternion: Array, velocity_c: Array) -> Array:
    """Return the (m, 3) attitude errors due to uncorrected aberration, in camera axes. Stars appear shifted towards the
    velocity."""
    in_cam = np.einsum("nij,nj->ni", np.stack([matrix_from_quaternion(q) for q in quaternion]), velocity_c)
    return np.cross(np.array([0.0, 0.0, 1.0]), in_cam)

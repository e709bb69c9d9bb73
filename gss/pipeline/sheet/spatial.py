"""Spatial errors from the residuals of identified stars: errors that vary slowly over the field, errors that are
periodic in a pixel, and errors that are fixed to pixels.

The attitude of a frame is fitted to the same stars as the residuals. Therefore the residuals of one frame do not show
the part of an error that acts like a rotation. Frames with stars at other positions show this part. The model of the
error is projected in the same way as the residuals: ``r = P·B·c``, where P removes the rotation that the fit absorbed.
The absorbed rotation of each frame is then computed from the fitted model. It is the error of the attitude.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.polynomial import legendre
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.errors import BadInput
from gss.pipeline.calibration.robust import robust_sigma
from gss.pipeline.sheet.rows import draws, interval

MIN_SIGHTINGS = 200
MIN_BLOCKS = 8
PER_UNKNOWN = 12
HARMONICS = 2
REJECT_SIGMAS = 5.0
FIRST_REJECT_SIGMAS = 15.0
MIN_SHARE = 1e-4
"""Minimum eigenvalue of the normal equations, relative to the largest. Directions with a smaller eigenvalue are not
observable; they are rotations of all frames."""
MAP_CELLS = 12
PHASE_POINTS = 41


@dataclass(frozen=True)
class StarSightings:
    """m sightings of identified stars in n frames. ``frame`` (m,): number of the frame, ascending; ``pixels`` (m, 2):
    measured positions; ``residual_px`` (m, 2): measured − predicted; ``weight`` (m,): weight in the attitude, 0 for
    stars that the chain rejected; ``hip`` (m,). ``block`` (n,): frames with equal labels have their stars at nearly the
    same pixels."""

    frame: NDArray[np.intp]
    pixels: Array
    residual_px: Array
    weight: Array
    hip: NDArray[np.int32]
    block: NDArray[np.intp]

    def __len__(self) -> int:
        return len(self.frame)


@dataclass(frozen=True)
class AxisError:
    """Root mean square of an attitude error over the frames, per camera axis (3,), in radians, with its 95 % interval."""

    value_rad: Array
    low_rad: Array
    high_rad: Array


@dataclass(frozen=True)
class StarError:
    """Position error of one star per axis in pixels, with its 95 % interval."""

    value_px: float
    low_px: float
    high_px: float


@dataclass(frozen=True)
class SpatialErrors:
    """Spatial errors. ``field``, ``phase``: attitude errors due to the slow part of the model and to the part periodic
    in a pixel; ``field_star``, ``phase_star``: their rms per star. ``map_col_px``, ``map_row_px``, ``map_px`` (r, c,
    2): the slow part over the detector. ``within_px`` (k,), ``curve_px`` (k, 2): the periodic part. ``noise_px``:
    robust scatter of the remaining residuals. ``rest_px`` (m, 2): residuals without the slow part, NaN for outliers;
    ``gain2`` (m, 2, 3): square of the attitude error about each axis per pixel of coordinate error; ``gain_rad_px`` (n,
    3): attitude noise of each frame for one pixel of independent noise per star and axis."""

    field: AxisError
    phase: AxisError
    field_star: StarError
    phase_star: StarError
    map_col_px: Array
    map_row_px: Array
    map_px: Array
    within_px: Array
    curve_px: Array
    noise_px: float
    rest_px: Array
    gain2: Array
    gain_rad_px: Array
    sightings: int
    frames: int
    degree: int


@dataclass(frozen=True)
class _FrameSums:
    """Contribution of one frame: normal equations, rotation per unit of each coefficient (3, p) and of each coordinate
    (3, 2k), and the moment of the slow model."""

    normal: Array
    right: Array
    turn: Array
    gain: Array
    moment: Array
    count: int


def rotation_effect(camera: Camera, pixels: Array) -> Array:
    """Return the (m, 2, 3) image motion, in pixels per radian of rotation about the camera axes, at (m, 2) positions."""
    step = 1e-6
    unit = camera.unproject(pixels)
    centre_px = camera.project(unit)
    columns = [(camera.project(unit + step * np.cross(np.eye(3)[k], unit)) - centre_px) / step for k in range(3)]
    return np.stack(columns, axis=-1)


def spatial_errors(sightings: StarSightings, camera: Camera, rng: np.random.Generator) -> SpatialErrors:
    """Fit the model and return the errors. Raises BadInput with too few stars or too few pointings."""
    seen = np.asarray(np.isfinite(sightings.residual_px).all(axis=1))
    used = seen & (sightings.weight > 0)
    keep = _inliers(sightings.residual_px, seen, FIRST_REJECT_SIGMAS)
    blocks = len(np.unique(sightings.block[sightings.frame[keep]]))
    if np.count_nonzero(keep) < MIN_SIGHTINGS or blocks < MIN_BLOCKS:
        raise BadInput(
            "too few stars for the spatial errors",
            expected=f"{MIN_SIGHTINGS} identified stars in frames of {MIN_BLOCKS} different pointings",
            got=f"{np.count_nonzero(keep)} stars, {blocks} pointings",
        )
    degree = 5 if np.count_nonzero(keep) * 2 > PER_UNKNOWN * (2 * _terms(5) + 4 * HARMONICS) else 3
    slow = 2 * _terms(degree)
    frames = [np.flatnonzero(seen & (sightings.frame == f)) for f in np.unique(sightings.frame[keep & used])]
    frame_sums = [_frame(sightings, at, keep[at], camera, degree) for at in frames]
    total = np.sum([f.normal for f in frame_sums], axis=0), np.sum([f.right for f in frame_sums], axis=0)
    first = _solve(*total)
    residual_rest = _rest(sightings, frames, camera, first[:slow], degree)
    # Outliers are detected after the slow error is subtracted.
    keep = _inliers(residual_rest, np.asarray(np.isfinite(residual_rest).all(axis=1)), REJECT_SIGMAS)
    frame_sums = [_frame(sightings, at, keep[at], camera, degree) for at in frames]
    best, drawn, often = _drawn(frame_sums, sightings.block[[int(sightings.frame[at[0]]) for at in frames]], rng)
    residual_rest = _rest(sightings, frames, camera, best[:slow], degree)
    residual_rest[~(keep & used)] = np.nan
    value, low, high = _debiased(frame_sums, _rotations(camera, degree), best, drawn, often)
    columns, rows, field = _map(camera, best[:slow], degree)
    within = np.linspace(-0.5, 0.5, PHASE_POINTS)
    return SpatialErrors(
        AxisError(value[:3], low[:3], high[:3]),
        AxisError(value[3:6], low[3:6], high[3:6]),
        StarError(float(value[6]), float(low[6]), float(high[6])),
        StarError(float(value[7]), float(low[7]), float(high[7])),
        columns,
        rows,
        field,
        within,
        np.asarray(_phase_terms(within) @ best[slow:].reshape(2, -1).T),
        float(np.mean([robust_sigma(residual_rest[:, k]) for k in (0, 1)])),
        residual_rest,
        _gains(sightings, frames, frame_sums),
        np.array([np.sqrt((f.gain**2).sum(axis=1)) for f in frame_sums]),
        int(np.count_nonzero(keep)),
        len(frame_sums),
        degree,
    )


def _drawn(
    frame_sums: list[_FrameSums], block: NDArray[np.intp], rng: np.random.Generator
) -> tuple[Array, Array, Array]:
    """Return the coefficients (p,), the coefficients of r bootstrap samples (r, p), and the number of occurrences of
    each frame in each sample (r, n)."""
    normals, rights = np.array([f.normal for f in frame_sums]), np.array([f.right for f in frame_sums])
    p = rights.shape[1]
    total = normals.sum(axis=0)
    best, observable = _solve(total, rights.sum(axis=0)), _observed(total)
    often = draws(block, rng)
    # Two matrix products compute the sums of all samples.
    shaped = observable.T @ normals @ observable
    sums = (often @ shaped.reshape(len(frame_sums), -1)).reshape(len(often), observable.shape[1], observable.shape[1])
    right = often @ (rights @ observable)
    tiny = np.eye(observable.shape[1]) * MIN_SHARE**2 * np.trace(total) / p
    return best, np.linalg.solve(sums + tiny, right[..., None])[..., 0] @ observable.T, often


def _debiased(
    frame_sums: list[_FrameSums], rotations: Array, best: Array, drawn: Array, often: Array
) -> tuple[Array, Array, Array]:
    """Return root mean squares over the frames with intervals. The star error is without the rotation common to all
    stars, which the residuals do not determine; ``rotations``: slow coefficients of each rotation. The noise of the
    coefficients increases a mean square. This noise is estimated from the spread of the bootstrap samples and
    subtracted. For the samples it is subtracted twice, because they contain it twice."""
    turns, moment = (
        np.array([f.turn for f in frame_sums]),
        sum(f.moment for f in frame_sums) / sum(f.count for f in frame_sums),
    )
    ones, slow = np.ones(len(frame_sums)), len(rotations)
    with_rotation = moment @ rotations
    moment = moment - with_rotation @ np.linalg.solve(rotations.T @ with_rotation, with_rotation.T)

    def squares(c: Array, weight: Array) -> Array:
        parts = []
        for part in (slice(0, slow), slice(slow, None)):
            error = turns[:, :, part] @ c[part]
            error = error - np.average(error, axis=0, weights=weight)
            parts.append(np.average(error**2, axis=0, weights=weight))
        star = float(c[:slow] @ moment @ c[:slow])
        return np.concatenate([*parts, [star, float(np.mean(c[slow:] ** 2) * HARMONICS)]])

    noise = np.mean([squares(c - best, ones) for c in drawn], axis=0)
    low, high = interval(np.array([squares(c, w) for c, w in zip(drawn, often, strict=True)]) - 2 * noise)
    value, bottom, top = (np.sqrt(np.maximum(v, 0)) for v in (squares(best, ones) - noise, low, high))
    return value, np.minimum(bottom, value), np.maximum(top, value)


def _rotations(camera: Camera, degree: int) -> Array:
    """Return the (slow, 3) slow coefficients of the image motion per radian of rotation about each camera axis."""
    cells = (np.arange(2 * degree + 2) + 0.5) / (2 * degree + 2)
    across, down = np.meshgrid(cells * camera.columns - 0.5, cells * camera.rows - 0.5)
    pixels = np.column_stack([across.ravel(), down.ravel()])
    slow = 2 * _terms(degree)
    design = _design(pixels, camera, degree)[:, :, :slow].reshape(-1, slow)
    return np.asarray(np.linalg.lstsq(design, rotation_effect(camera, pixels).reshape(-1, 3), rcond=None)[0])


def _inliers(residual_px: Array, used: NDArray[np.bool_], sigmas: float) -> NDArray[np.bool_]:
    """Return an (m,) mask, True for used stars whose residual is not an outlier."""
    if not used.any():
        return used
    spread = np.array([robust_sigma(residual_px[used, k]) for k in (0, 1)])
    off = np.abs(residual_px - np.median(residual_px[used], axis=0))
    return np.asarray(used & (off <= sigmas * np.maximum(spread, 1e-6)).all(axis=1))


def _terms(degree: int) -> int:
    return (degree + 1) * (degree + 2) // 2


def _slow_terms(pixels: Array, camera: Camera, degree: int) -> Array:
    """Return (m, terms) products of Legendre polynomials over the detector, up to a total degree."""
    u = 2 * (pixels[:, 0] + 0.5) / camera.columns - 1
    v = 2 * (pixels[:, 1] + 0.5) / camera.rows - 1
    across, down = legendre.legvander(u, degree), legendre.legvander(v, degree)
    return np.stack([across[:, i] * down[:, j] for i in range(degree + 1) for j in range(degree + 1 - i)], axis=1)


def _phase_terms(within_px: Array) -> Array:
    """Return (m, 2·HARMONICS) sines and cosines of the position within the pixel."""
    angles = 2 * np.pi * np.outer(within_px, np.arange(1, HARMONICS + 1))
    return np.concatenate([np.sin(angles), np.cos(angles)], axis=1)


def _design(true_px: Array, camera: Camera, degree: int) -> Array:
    """Return the (m, 2, p) derivatives of the coordinate errors with respect to the coefficients: slow part, then periodic part."""
    slow = _slow_terms(true_px, camera, degree)
    within = true_px - np.round(true_px)
    blocks = [slow, slow, _phase_terms(within[:, 0]), _phase_terms(within[:, 1])]
    starts = np.cumsum([0, *(b.shape[1] for b in blocks)])
    design = np.zeros((len(true_px), 2, starts[-1]))
    for k, b in enumerate(blocks):
        design[:, k % 2, starts[k] : starts[k + 1]] = b
    return design


def _absorbed(sightings: StarSightings, rows: NDArray[Any], camera: Camera) -> tuple[Array, Array]:
    """Return, for the k stars ``rows`` of a frame, the effect of rotations (2k, 3), and the least-squares rotation per
    pixel (3, 2k), which is 0 for the stars that the attitude does not use."""
    effect = rotation_effect(camera, sightings.pixels[rows]).reshape(-1, 3)
    weight = np.repeat(sightings.weight[rows] / sightings.weight[rows].max(), 2)
    gain = np.linalg.pinv(effect.T @ (effect * weight[:, None])) @ (effect * weight[:, None]).T
    return effect, gain


def _frame(
    sightings: StarSightings, rows: NDArray[np.intp], keep: NDArray[np.bool_], camera: Camera, degree: int
) -> _FrameSums:
    """Return the contribution of a frame with the stars ``rows``. The equations contain only the stars in the mask
    ``keep``."""
    effect, gain = _absorbed(sightings, rows, camera)
    attitude_weight = sightings.weight[rows]
    # A rejected star has the weight of a typical star.
    star_weight = np.where(attitude_weight > 0, attitude_weight, np.median(attitude_weight[attitude_weight > 0]))
    weight = np.repeat(star_weight / star_weight.mean(), 2)
    design = _design(sightings.pixels[rows] - sightings.residual_px[rows], camera, degree)
    attitude_stars = keep & (attitude_weight > 0)
    slow = design[attitude_stars][:, :, : 2 * _terms(degree)]
    flat = design.reshape(-1, design.shape[2])
    turn = gain @ flat
    keep_coordinates = np.repeat(keep, 2)
    reduced = (flat - effect @ turn)[keep_coordinates]
    residual = sightings.residual_px[rows].ravel()
    residual = (residual - effect @ (gain @ residual))[keep_coordinates]
    return _FrameSums(
        reduced.T @ (reduced * weight[keep_coordinates, None]),
        reduced.T @ (weight[keep_coordinates] * residual),
        turn,
        gain,
        np.einsum("mkp,mkq->pq", slow, slow, optimize=True) / 2,
        int(attitude_stars.sum()),
    )


def _gains(sightings: StarSightings, frames: list[NDArray[np.intp]], frame_sums: list[_FrameSums]) -> Array:
    """Return the (m, 2, 3) squared sensitivities of the attitude to each star coordinate."""
    gains = np.zeros((len(sightings), 2, 3))
    for rows, frame_sum in zip(frames, frame_sums, strict=True):
        gains[rows] = (frame_sum.gain.T**2).reshape(-1, 2, 3)
    return gains


def _rest(sightings: StarSightings, frames: list[NDArray[np.intp]], camera: Camera, slow: Array, degree: int) -> Array:
    """Return the (m, 2) residuals without the slow part; NaN for stars that are in none of the frames."""
    remainder = np.full_like(sightings.residual_px, np.nan)
    for rows in frames:
        effect, gain = _absorbed(sightings, rows, camera)
        design = _design(sightings.pixels[rows] - sightings.residual_px[rows], camera, degree)[:, :, : len(slow)]
        residual = sightings.residual_px[rows].ravel() - (design @ slow).ravel()
        remainder[rows] = (residual - effect @ (gain @ residual)).reshape(-1, 2)
    return remainder


def _observed(normal: Array) -> Array:
    """Return the (p, q) observable directions of the coefficients."""
    values, vectors = np.linalg.eigh(normal)
    return np.asarray(vectors[:, values > MIN_SHARE * values[-1]])


def _solve(normal: Array, right: Array) -> Array:
    """Return the least-squares solution in the observable directions."""
    observable = _observed(normal)
    return np.asarray(observable @ np.linalg.solve(observable.T @ normal @ observable, observable.T @ right))


def _map(camera: Camera, slow: Array, degree: int) -> tuple[Array, Array, Array]:
    step = max(camera.columns, camera.rows) / MAP_CELLS
    columns = (np.arange(max(1, round(camera.columns / step))) + 0.5) * step - 0.5
    rows = (np.arange(max(1, round(camera.rows / step))) + 0.5) * step - 0.5
    across, down = np.meshgrid(columns, rows)
    terms = _slow_terms(np.column_stack([across.ravel(), down.ravel()]), camera, degree)
    field = np.asarray(terms @ slow.reshape(2, -1).T).reshape(len(rows), len(columns), 2)
    return np.asarray(columns, float), np.asarray(rows, float), field

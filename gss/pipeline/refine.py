"""Joint fit of attitude and camera geometry by robust least squares on every matched star of a frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array
from gss.domain.camera import Brown, Camera, Pinhole
from gss.domain.rotation import rotation_from_vector
from gss.pipeline.small import median

ROUNDS = 8
DONE = 1e-10
ATTITUDE_DONE = (
    1e-5  # limit of a step; the error after such a step is at most a thousandth of it, about a milliarcsecond
)
OUTLIER_SIGMA = 4.0
CORNER_DISTORTION = 0.02  # prior sigma of the distortion of an unknown lens at the corners, relative to the radius
ASPECT_SIGMA = 0.1  # prior sigma of the log aspect ratio of an unknown camera's pixels
CENTRE_SIGMA = 0.12  # prior sigma of the optical axis's offset from the middle, relative to the frame's width
CALIBRATED_CENTRE_PX = 10.0  # prior sigma of the optical axis's offset from its calibration
BROWN = ("k1", "k2", "p1", "p2")
AXES = {"col": np.array([1.0, 0.0]), "row": np.array([0.0, 1.0])}
STEP = 1e-6
NOWHERE_PX = 1e9  # residual of a star that the camera cannot image
MAX_RAD = 0.2  # largest rotation per axis in one step
DISPLACED = 1e-3  # a star counts as displaced if the probability, over all stars of the frame, is below this
LEAST_FREEDOM = 5  # of the other stars: with four stars in two pairs, either star of a pair can appear displaced
BELIEF = 20.0  # number of degrees of freedom with which the stated errors of the centroids are weighted


@dataclass(frozen=True)
class Refined:
    """Result of the fit: camera geometry and attitude. ``residual_px``: (n, 2) measured − predicted. ``weight``: (n,),
    0 for outliers. ``parameters``: names of the p fitted parameters. ``covariance``: (p, p) of the parameters."""

    camera: Camera
    cam_from_icrs: Array
    residual_px: Array
    weight: Array
    rms_px: float
    parameters: tuple[str, ...] = ("x", "y", "z")
    covariance: Array = field(default_factory=lambda: np.eye(3))

    @property
    def covariance_rad2(self) -> Array:
        """Return the (3, 3) covariance of the rotation vector in the camera frame, including the effect of free camera
        parameters."""
        return self.covariance[:3, :3]


def refine(
    pixels: Array,
    icrs: Array,
    sigma_px: Array,
    camera: Camera,
    cam_from_icrs: Array,
    *,
    fit_focal: bool = False,
    fit_lens: Sequence[str] = (),
    calibration: Camera | None = None,
) -> Refined:
    """Fit the attitude to (n, 2) pixels of (n, 3) ICRS stars. With ``fit_focal``, also fit a common factor of both
    focal lengths.

    ``fit_lens`` names further parameters: the coefficients k1 k2 p1 p2 of a :class:`Brown` lens, the ``aspect`` of the
    two focal lengths, and the optical centre's ``col`` and ``row``. If the stars do not determine them, a prior keeps
    them near zero, near one and near the middle, or near the values of ``calibration``, if given. The distortion of
    ``camera`` must be Brown if coefficients are fitted.
    The method is Gauss–Newton. Outliers beyond 4 robust sigmas have zero weight, and so has a
    star that is far from the position predicted by the others (:func:`displacements`) in a fit that converges. Each
    exclusion has a further ``ROUNDS`` rounds.
    """
    names = ["x", "y", "z", *(["focal"] if fit_focal else []), *fit_lens]
    prior = _prior(camera, names, calibration)
    expected = np.array([value_of(calibration, name) if calibration else 0.0 for name in names])
    weight = 1 / np.asarray(sigma_px, float) ** 2
    used, displaced = np.ones(len(pixels), bool), np.zeros(len(pixels), bool)
    residual = np.zeros((len(pixels), 2))
    done, ridge = ATTITUDE_DONE if len(names) == 3 else DONE, 1 + 1e-12 * np.eye(len(names))
    left = ROUNDS
    while left:
        left -= 1
        residual, jacobian = linearised(pixels, icrs, camera, cam_from_icrs, names)
        before, used = used, _inliers(residual, weight, len(names)) & ~displaced
        w = np.repeat(np.where(used, weight, 0.0), 2)
        j = jacobian.reshape(-1, len(names))
        weighted = (w[:, None] * j).T
        normal, gradient = weighted @ j, weighted @ residual.ravel()
        if len(names) > 3:
            values = np.array([value_of(camera, n) for n in names])
            normal, gradient = normal + np.diag(prior), gradient - prior * (values - expected)
        step = np.asarray(np.linalg.solve(normal * ridge, gradient), float)
        camera, cam_from_icrs = _moved(camera, cam_from_icrs, step, names)
        if np.abs(step).max() < done and (used == before).all():
            residual = residual - jacobian @ step
            chance, _ = displacements(residual, jacobian, np.where(used, weight, 0.0), normal * ridge)
            if chance.min() >= DISPLACED:
                break
            displaced[chance.argmin()] = True
            left = ROUNDS
    else:
        residual = pixels - camera.project(icrs @ cam_from_icrs.T)
    good = (np.abs(residual) < NOWHERE_PX).all(1) & used
    rms = float(np.sqrt((residual[good] ** 2).mean())) if good.any() else float("inf")
    covariance = _covariance(normal, residual, weight, good, len(names))
    return Refined(camera, cam_from_icrs, residual, np.where(good, weight, 0.0), rms, tuple(names), covariance)


def displacements(residual: Array, jacobian: Array, weight: Array, normal: Array) -> tuple[Array, Array]:
    """Return for each star the probability, over all stars of the frame, that it is so far from the position predicted by the
    others, and this distance in pixels. Both are (n,); the probability is 1 if there are too few stars.

    A star far from the others determines the rotation about them, so its own residual is small even if it is displaced.
    Therefore each star is compared with a fit without it. ``residual``: (n, 2) after the fit; ``jacobian``: (n, 2, p);
    ``weight``: (n,) 1/σ², 0 for excluded stars; ``normal``: (p, p) normal matrix.

    If a star is removed, χ² decreases by d, and ν degrees of freedom are left. For normal errors of unknown scale, d/2
    divided by the rest of χ² per degree of freedom has an F distribution with 2 and ν degrees of freedom, whose tail is
    (1 + d / rest)^(−ν/2). The scale is at least that of the stated errors.
    """
    freedom = 2 * (int(np.count_nonzero(weight)) - 1) - len(normal)
    if freedom < LEAST_FREEDOM:
        return np.ones(len(weight)), np.zeros(len(weight))
    left = np.eye(2) - weight[:, None, None] * (jacobian @ np.linalg.inv(normal) @ jacobian.transpose(0, 2, 1))
    a, b, c, d = left[:, 0, 0], left[:, 0, 1], left[:, 1, 0], left[:, 1, 1]
    determinant = a * d - b * c
    across, down = residual[:, 0], residual[:, 1]
    ok = (weight > 0) & (determinant > 1e-9)  # the others determine the position of such a star
    scale = np.where(ok, 1 / np.where(ok, determinant, 1.0), 0.0)
    off_col, off_row = (d * across - b * down) * scale, (a * down - c * across) * scale
    decrease = np.maximum(weight * (across * off_col + down * off_row), 0.0)
    rest = np.maximum((weight * (across**2 + down**2)).sum() - decrease, freedom)
    chance = np.count_nonzero(weight) * (1 + decrease / rest) ** (-freedom / 2)
    return np.asarray(chance), np.asarray(np.hypot(off_col, off_row))


def _prior(camera: Camera, names: Sequence[str], calibration: Camera | None) -> Array:
    """Return the (p,) prior information (1/σ²) on each parameter of a typical lens, or of one near its calibration; 0
    for attitude and focal length."""
    corner = float(np.tan(min(camera.half_diagonal_rad, 1.2)))
    centre_px = CALIBRATED_CENTRE_PX if calibration else CENTRE_SIGMA * camera.columns
    loose = {"k1": 1 / corner**2, "k2": 1 / corner**4, "p1": 0.2 / corner, "p2": 0.2 / corner}
    sigma = {name: CORNER_DISTORTION * size for name, size in loose.items()} | {
        "aspect": ASPECT_SIGMA,
        "col": centre_px / camera.focal_col_px,
        "row": centre_px / camera.focal_row_px,
    }
    return np.array([sigma[name] ** -2 if name in sigma else 0.0 for name in names])


def value_of(camera: Camera, name: str) -> float:
    """Return the current value of a lens parameter; 0 for a perfect lens."""
    if name == "aspect":
        return float(np.log(camera.focal_row_px / camera.focal_col_px))
    if name == "col":
        return (camera.centre_col_px - (camera.columns - 1) / 2) / camera.focal_col_px
    if name == "row":
        return (camera.centre_row_px - (camera.rows - 1) / 2) / camera.focal_row_px
    return float(getattr(camera.distortion, name, 0.0))


def prediction_sigma_px(fit: Refined, icrs: Array) -> Array:
    """Return the (n,) standard deviations per axis of the predicted positions of (n, 3) stars, from the errors of all
    fitted parameters."""
    _, jacobian = linearised(np.zeros((len(icrs), 2)), icrs, fit.camera, fit.cam_from_icrs, list(fit.parameters))
    variance = ((jacobian @ fit.covariance) * jacobian).sum((1, 2))
    return np.asarray(np.sqrt(np.maximum(variance, 0) / 2))


def linearised(
    pixels: Array, icrs: Array, camera: Camera, cam_from_icrs: Array, names: Sequence[str] = ("x", "y", "z")
) -> tuple[Array, Array]:
    """Return the residuals (n, 2) and the derivatives (n, 2, parameters) of the predicted positions."""
    base, ideal, rotation_slopes = _projected(icrs @ cam_from_icrs.T, camera)
    jacobian = rotation_slopes
    if len(names) > 3:
        jacobian = np.empty((len(icrs), 2, len(names)))
        jacobian[..., :3] = rotation_slopes
        for k, name in enumerate(names[3:], 3):
            jacobian[..., k] = _slope(name, camera, ideal, base)
    residual = pixels - base
    if not np.isfinite(jacobian.sum() + residual.sum()):
        bad: NDArray[np.bool_] = np.asarray(~np.isfinite(residual).all(1) | ~np.isfinite(jacobian).all((1, 2)))
        jacobian[bad], residual[bad] = 0.0, NOWHERE_PX
    return residual, jacobian


def _projected(unit: Array, camera: Camera) -> tuple[Array, Array, Array]:
    """Return the (n, 2) pixels of camera-frame vectors, their (n, 2) positions on the tangent plane, and the (n, 2, 3)
    derivatives of the pixels with respect to a small rotation about x, y, z. The derivatives are exact on the tangent
    plane and finite differences through the distortion."""
    n = len(unit)
    z = np.where(unit[:, 2] > 1e-6, unit[:, 2], np.nan)
    x, y = unit[:, 0] / z, unit[:, 1] / z
    plane = np.empty((n, 2, 3))
    xy = x * y
    plane[:, 0, 0], plane[:, 0, 1], plane[:, 0, 2] = -xy, 1 + x * x, -y
    plane[:, 1, 0], plane[:, 1, 1], plane[:, 1, 2] = -1 - y * y, xy, x
    focal = np.array([camera.focal_col_px, camera.focal_row_px])
    centre = np.array([camera.centre_col_px, camera.centre_row_px])
    if isinstance(camera.distortion, Pinhole):
        tangent = np.column_stack([x, y])
        return tangent * focal + centre, tangent, plane * focal[:, None]
    ideal = np.empty((3, n, 2))
    ideal[..., 0], ideal[..., 1] = x, y
    ideal[1, :, 0] += STEP
    ideal[2, :, 1] += STEP
    distorted = camera.distortion.distort(ideal.reshape(-1, 2)).reshape(3, n, 2)
    across, down = (distorted[1] - distorted[0]) / STEP, (distorted[2] - distorted[0]) / STEP
    slopes = across[:, :, None] * plane[:, None, 0] + down[:, :, None] * plane[:, None, 1]
    return distorted[0] * focal + centre, ideal[0], slopes * focal[:, None]


def _slope(name: str, camera: Camera, ideal: Array, pixels: Array) -> Array:
    """Return the derivatives of ``pixels`` with respect to a camera parameter, (n, 2) or equal for all n stars. ``ideal``:
    (n, 2) positions on the tangent plane. The steps of the parameters are those of :func:`_moved`."""
    focal = np.array([camera.focal_col_px, camera.focal_row_px])
    if name in AXES:
        return np.asarray(focal * AXES[name])
    if name in ("focal", "aspect"):
        offset = pixels - (camera.centre_col_px, camera.centre_row_px)
        return np.asarray(offset if name == "focal" else offset * AXES["row"])
    if not isinstance(camera.distortion, Brown):
        return np.zeros(2)
    x, y = ideal[:, 0], ideal[:, 1]
    r2 = x * x + y * y
    if name in ("k1", "k2"):
        return np.asarray(ideal * (r2 if name == "k1" else r2 * r2)[:, None] * focal)
    across = 2 * x * y
    slopes = (across, r2 + 2 * y * y) if name == "p1" else (r2 + 2 * x * x, across)
    return np.asarray(np.stack(slopes, axis=1) * focal)


def _moved(camera: Camera, cam_from_icrs: Array, step: Array, names: Sequence[str]) -> tuple[Camera, Array]:
    """Return camera and attitude after a step of the parameters."""
    rotation = step[:3] if np.abs(step[:3]).max() <= MAX_RAD else np.clip(step[:3], -MAX_RAD, MAX_RAD)
    rotated = rotation_from_vector(rotation) @ cam_from_icrs if rotation.any() else cam_from_icrs
    if len(names) == 3:
        return camera, rotated
    by = dict(zip(names[3:], step[3:].tolist(), strict=True))
    factor, aspect = (math.exp(min(max(by.get(name, 0.0), -0.3), 0.3)) for name in ("focal", "aspect"))
    focal_col_px, focal_row_px = camera.focal_col_px * factor, camera.focal_row_px * factor
    distortion = camera.distortion
    if isinstance(distortion, Brown):
        changed = {name: getattr(distortion, name) + by[name] for name in BROWN if name in by}
        distortion = replace(distortion, **changed) if changed else distortion
    camera = replace(
        camera,
        focal_col_px=focal_col_px,
        focal_row_px=focal_row_px * aspect,
        centre_col_px=camera.centre_col_px + by.get("col", 0.0) * focal_col_px,
        centre_row_px=camera.centre_row_px + by.get("row", 0.0) * focal_row_px,
        distortion=distortion,
    )
    return camera, rotated


def _inliers(residual: Array, weight: Array, parameters: int) -> NDArray[np.bool_]:
    """Return a mask of the stars within 4 robust sigmas, or of all visible stars if there are too few to estimate the spread."""
    scaled = np.sqrt((residual * residual).sum(1) * weight)
    if len(scaled) <= parameters // 2 + 3:
        return np.asarray(scaled < 1e6)
    spread = max(median(scaled) / 1.1774, 1.0)
    return np.asarray(scaled < OUTLIER_SIGMA * 1.2 * spread)


def _covariance(normal: Array, residual: Array, weight: Array, good: NDArray[np.bool_], parameters: int) -> Array:
    """Return the inverse information scaled by the residuals. If the residuals are larger than the stated errors of the
    centroids, they scale the covariance fully. If they are smaller, the stated errors are weighted with ``BELIEF``
    degrees of freedom, so only many stars can reduce the covariance."""
    freedom = 2 * int(good.sum()) - parameters
    if freedom <= 0:
        factor = 1.0
    else:
        chi2 = float(np.sum(residual[good] ** 2 * weight[good, None]))
        factor = chi2 / freedom if chi2 > freedom else (chi2 + BELIEF) / (freedom + BELIEF)
    return np.asarray(np.linalg.inv(normal + 1e-12 * np.diag(np.diag(normal))) * factor)

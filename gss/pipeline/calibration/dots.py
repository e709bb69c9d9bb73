"""Bench calibration with one or two bright dots. Rotation of the camera about its axis gives the optical centre and the
detector tilt (Jacobs 1995 §6.2.1, §6.2.3.1, app. F.2)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from gss.domain.angles import Array
from gss.domain.camera import Camera
from gss.domain.errors import BadInput
from gss.pipeline.calibration.advice import Advice
from gss.pipeline.calibration.robust import fit_linear

MIN_TURNS = 6
ROUND = 5.0  # minimum ratio of radius to scatter of a circle; random positions give a ratio of about two
FULL_BOX_PX = 20.0  # Jacobs' dot stayed within 12 x 12 px
TURN_COVERED = 2 / 3
MAX_PX = 1e6
MIN_ARM_PX = 1.0


@dataclass(frozen=True)
class OpticalCentre:
    """Optical centre on the detector. ``circle``: True if it is the centre of a circle through the positions, False
    if it is the middle of their bounding box. ``sigma_px``: of col or row, whichever is larger. ``radius_px``: radius of
    the circle; ``box_px``: extent of the positions in col and row."""

    col_px: float
    row_px: float
    sigma_px: float
    radius_px: float
    box_px: tuple[float, float]
    circle: bool
    warnings: tuple[Advice, ...]


def optical_centre(dots_px: Array) -> OpticalCentre:
    """Find the optical axis on the detector from (n, 2) positions of one dot near it while the camera is rotated about
    the axis.

    The dot moves on a circle around the centre. If the mechanical play of the clamp is larger than the circle, the
    middle of the bounding box is used, as in the document.
    """
    dots = _checked(dots_px)
    box = np.ptp(dots, axis=0)
    # Linear fit of a circle, x² + y² = 2ax + 2by + c (Kåsa).
    middle = dots.mean(axis=0)
    off = dots - middle
    design = np.column_stack([2 * off, np.ones(len(off))])
    fit = fit_linear(design, (off**2).sum(axis=1))
    a, b, c = (float(v) for v in fit.coefficients)
    radius = float(np.sqrt(max(c + a * a + b * b, 0.0)))
    scatter = float(np.std(np.hypot(off[:, 0] - a, off[:, 1] - b) - radius))
    angle = np.sort(np.arctan2(off[:, 1] - b, off[:, 0] - a))
    gap = float(np.max(np.diff(np.append(angle, angle[0] + 2 * np.pi))))
    circle = radius > ROUND * scatter and gap < 2 * np.pi * (1 - TURN_COVERED / 2)
    advice: list[Advice] = []
    if box.max() > FULL_BOX_PX and not circle:
        text = f"the dot wandered over {box[0]:.0f} x {box[1]:.0f} px"
        advice.append(
            Advice("far-dot", text, "move the dot nearer to the axis, until it hardly moves when the camera rotates")
        )
    if gap > 2 * np.pi * (1 - TURN_COVERED):
        text = f"{np.degrees(gap):.0f}° of the rotation have no position of the dot"
        advice.append(Advice("one-part", text, "rotate the camera through a full circle in steps of 10° to 30°"))
    if circle:
        centre = middle + np.array([a, b])
        sigma = float(np.sqrt(max(fit.covariance[0, 0], fit.covariance[1, 1])))
    else:
        centre = (dots.max(axis=0) + dots.min(axis=0)) / 2
        sigma = _middle_factor(len(dots)) * float(np.std(dots, axis=0, ddof=1).max())
    return OpticalCentre(
        float(centre[0]), float(centre[1]), sigma, radius, (float(box[0]), float(box[1])), circle, tuple(advice)
    )


def _middle_factor(n: int) -> float:
    """Return the σ of the middle between the smallest and the largest of n normally distributed values, in units of
    their σ. This is the limit for large n; for n = 6 it is too small by 2 %."""
    return float(np.pi / np.sqrt(24 * np.log(n)))


@dataclass(frozen=True)
class DetectorTilt:
    """Tilt of the detector (eq. 6.14): maximum tilt and its direction, from camera +x (col) towards +y (row).
    ``sigma_rad``: σ of both. ``radius_mm``: distance of the dots without tilt. ``residual_mm``: (n,) measured − eq.
    6.15."""

    tilt_max_rad: float
    tilt_direction_rad: float
    sigma_rad: tuple[float, float]
    radius_mm: float
    angle_rad: Array
    distance_mm: Array
    residual_mm: Array
    rms_mm: float
    warnings: tuple[Advice, ...]


def detector_tilt(inner_px: Array, outer_px: Array, camera: Camera, focal_mm: float) -> DetectorTilt:
    """Fit eq. 6.15 by least squares to the distance between a dot near the optical centre and a dot far from it.
    ``inner_px``, ``outer_px``: (n, 2) positions of both dots while the camera is rotated. ``camera``: centre and plate
    scale; ``focal_mm``: focal length of the camera."""
    inner, outer = _checked(inner_px, still=True), _checked(outer_px)
    if inner.shape != outer.shape:
        raise BadInput(
            "the numbers of inner and outer dots differ",
            expected=f"{len(inner)} positions of both",
            got=str(len(outer)),
        )
    pitch_mm = focal_mm / np.array([camera.focal_col_px, camera.focal_row_px])
    arm = (outer - inner) * pitch_mm
    angle, distance = np.arctan2(arm[:, 1], arm[:, 0]), np.hypot(arm[:, 0], arm[:, 1])

    if np.hypot(*(outer - inner).T).min() < MIN_ARM_PX:
        raise BadInput(
            "the two dots have the same position",
            expected="one dot near the centre, one far out",
            got="positions less than 1 px apart",
        )

    if np.ptp(outer - inner, axis=0).max() < 1e-6:
        raise BadInput(
            "the dots did not move",
            expected="positions that change when the camera rotates",
            got=f"{len(inner)} equal pairs of positions",
            hint="measure both dots again after each rotation",
        )

    def model(p: Array) -> Array:
        # The tilt is fitted as a vector, because the direction of a small tilt is undefined.
        sine = np.sin(np.hypot(p[0], p[1])) * np.cos(angle - np.arctan2(p[1], p[0]))
        theta = np.arcsin(sine)
        return np.asarray(p[2] / np.cos(theta) / (1 - p[2] / focal_mm * np.tan(theta)))

    start = np.array([1e-3, 1e-3, float(np.median(distance))])
    from scipy.optimize import least_squares  # the import takes 10 MB of memory

    fit = least_squares(lambda p: model(p) - distance, start, x_scale=[1e-2, 1e-2, 1.0], loss="soft_l1", f_scale=1e-3)
    residual = distance - model(fit.x)
    rms = float(np.sqrt(np.mean(residual**2)))
    freedom = max(len(distance) - 3, 1)
    covariance = np.linalg.pinv(fit.jac.T @ fit.jac) * float(np.sum(residual**2)) / freedom
    tilt = float(np.hypot(fit.x[0], fit.x[1]))
    along = np.array([fit.x[0], fit.x[1]]) / max(tilt, 1e-12)
    sigma = float(np.sqrt(along @ covariance[:2, :2] @ along))
    across = np.array([-along[1], along[0]])
    turn_sigma = float(np.sqrt(across @ covariance[:2, :2] @ across)) / max(tilt, 1e-12)
    advice: list[Advice] = []
    if tilt < 3 * sigma:
        text = f"the tilt of {np.degrees(tilt):.3f}° is within its error of {np.degrees(sigma):.3f}°"
        advice.append(Advice("no-tilt", text, "assume no tilt, or use a dot farther out and more rotations"))
    direction = float(np.arctan2(fit.x[1], fit.x[0])) % (2 * np.pi)
    return DetectorTilt(
        tilt, direction, (sigma, turn_sigma), float(fit.x[2]), angle, distance, residual, rms, tuple(advice)
    )


def _checked(dots_px: Array, *, still: bool = False) -> Array:
    dots = np.asarray(dots_px, float)
    if dots.ndim != 2 or dots.shape[1] != 2 or len(dots) < MIN_TURNS or not np.isfinite(dots).all():
        raise BadInput(
            "these are not valid positions of a dot",
            expected=f"{MIN_TURNS} or more positions (col, row), one per rotation",
            got=f"{dots.shape}",
            hint="Jacobs took 36, every 10°",
        )
    if np.abs(dots).max() > MAX_PX:
        description = f"{np.abs(dots).max():g} px"
        raise BadInput("a dot is outside the detector", expected=f"within {MAX_PX:g} px", got=description)
    if not np.ptp(dots, axis=0).any() and not still:
        raise BadInput(
            "the dot did not move",
            expected="positions that change when the camera rotates",
            got=f"{len(dots)} equal positions",
            hint="measure the dot again after each rotation",
        )
    return dots

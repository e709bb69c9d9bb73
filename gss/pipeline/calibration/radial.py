"""Jacobs' radial distortion polynomial, from the distances of all stars to a star near the optical centre (Jacobs 1995
§6.2.3.1, eq. 6.16–6.17, F.9)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from gss.domain.angles import Array, separation_rad
from gss.domain.camera import Camera, RadialTilt
from gss.domain.errors import BadInput
from gss.domain.words import counted
from gss.pipeline.calibration.advice import Advice
from gss.pipeline.calibration.robust import fit_linear
from gss.pipeline.calibration.sightings import FrameStars

NEAR_CENTRE_MM = 0.45  # maximum distance between the optical centre and the star that represents it
MIN_STARS = 12


@dataclass(frozen=True)
class RadialFit:
    """Fitted polynomial Δr = k₁r + k₂r² + …, millimetres: ``coefficients`` and ``sigma`` (order,). Per star: ``r_mm``
    measured distance, ``delta_mm`` measured − true, ``residual_mm`` after the polynomial, ``used``."""

    coefficients: Array
    sigma: Array
    r_mm: Array
    delta_mm: Array
    residual_mm: Array
    used: NDArray[np.bool_]
    rms_mm: float
    frames: int
    warnings: tuple[Advice, ...]


def radial_polynomial(
    frames: Sequence[FrameStars], camera: Camera, focal_mm: float, order: int = 3, near_mm: float = NEAR_CENTRE_MM
) -> RadialFit:
    """Fit the polynomial to frames with a star near the optical centre. The tilt of the camera is corrected first; its
    radial polynomial is not."""
    tilt = camera.distortion
    flat = RadialTilt(focal_mm, tilt.tilt_max_rad, tilt.tilt_direction_rad) if isinstance(tilt, RadialTilt) else None
    r_parts, delta_parts, used_frames = [], [], 0
    centre = np.array([camera.centre_col_px, camera.centre_row_px])
    focal = np.array([camera.focal_col_px, camera.focal_row_px])
    for frame in frames:
        ideal = (frame.pixels - centre) / focal
        place_mm = (ideal if flat is None else flat.undistort(ideal)) * focal_mm
        radius_mm = np.hypot(place_mm[:, 0], place_mm[:, 1])
        k = int(np.argmin(radius_mm)) if len(radius_mm) else 0
        if len(radius_mm) < 2 or radius_mm[k] > near_mm:
            continue
        used_frames += 1
        other_stars = np.arange(len(radius_mm)) != k
        # From the centre of a plane detector, the tangent of the separation is the radius. The ray of the central star
        # corrects for
        # its small offset from the centre.
        ray = np.append(place_mm, np.full((len(radius_mm), 1), focal_mm), axis=1)
        ray /= np.linalg.norm(ray, axis=1, keepdims=True)
        measured = separation_rad(ray[other_stars], ray[k])
        true = separation_rad(frame.icrs[other_stars], frame.icrs[k])
        r_parts.append(radius_mm[other_stars])
        # The error of the angle is the error of the radius times cos² of the field angle.
        delta_parts.append(focal_mm * (measured - true) * (1 + (radius_mm[other_stars] / focal_mm) ** 2))
    r = np.concatenate(r_parts) if r_parts else np.empty(0)
    if len(r) < max(MIN_STARS, order + 2):
        raise BadInput(
            "too few stars in frames with a star near the optical centre",
            expected=f"{MIN_STARS} in frames with a star within {near_mm:g} mm of the centre",
            got=f"{len(r)} in {counted(used_frames, 'frame')}",
            hint="image a dense part of the sky: at least half the frames then have such a star",
        )
    delta = np.concatenate(delta_parts)
    fit = fit_linear(np.column_stack([r ** (k + 1) for k in range(order)]), delta)
    rms = float(np.sqrt(np.mean(fit.residual[fit.used] ** 2)))
    return RadialFit(
        fit.coefficients,
        np.sqrt(np.diag(fit.covariance)),
        r,
        delta,
        fit.residual,
        fit.used,
        rms,
        used_frames,
        tuple(_warnings(r, camera, focal_mm)),
    )


def _warnings(r_mm: Array, camera: Camera, focal_mm: float) -> list[Advice]:
    corner = np.array([camera.columns / camera.focal_col_px, camera.rows / camera.focal_row_px]) / 2
    reach = focal_mm * float(np.hypot(corner[0], corner[1]))
    if r_mm.max() > 0.8 * reach:
        return []
    text = f"no star beyond {r_mm.max():.2f} mm; the corner is at {reach:.2f} mm"
    return [Advice("one-part", text, "use more frames: the polynomial is not valid beyond its last star")]

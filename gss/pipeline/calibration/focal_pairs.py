"""Focal length from pairs of stars whose true separation is known (Jacobs 1995 eq. 6.4–6.6, Erlank 2013 eq. 5.4.1)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from gss.domain.angles import Array, separation_rad
from gss.domain.camera import Camera
from gss.domain.errors import BadInput
from gss.pipeline.calibration.advice import Advice
from gss.pipeline.calibration.robust import robust_sigma
from gss.pipeline.calibration.sightings import FrameStars

NEAR_CENTRE = 0.5
MIN_PAIRS = 3
SHORTEST = 0.1
MAX_PAIRS = 20_000


def focal_from_pair(first: Array, second: Array, separation_true_rad: float) -> float:
    """Return the focal length in the unit of the two (2,) positions, which are relative to the optical centre. NaN if
    no pinhole camera images this separation at these positions.

    (u₁·u₂ + f²)² = cos²θ·(|u₁|² + f²)(|u₂|² + f²) is quadratic in f². The equation is scaled by sin²θ relative to the
    document's coefficients a, b and c, which lose precision for small angles.
    """
    u1, u2 = np.asarray(first, float), np.asarray(second, float)
    dot, first2, second2 = float(u1 @ u2), float(u1 @ u1), float(u2 @ u2)
    sine2 = float(np.sin(separation_true_rad)) ** 2
    cosine2 = 1 - sine2
    # f⁴ sin² + f² (2·dot − cos²(one + two)) + dot² − cos²·one·two = 0; the middle term is written as a sum of small numbers.
    b = -float((u1 - u2) @ (u1 - u2)) + sine2 * (first2 + second2)
    c = dot**2 - cosine2 * first2 * second2
    root = b * b - 4 * sine2 * c
    if sine2 == 0 or root < 0:
        return float("nan")
    square = (-b + float(np.sqrt(root))) / (2 * sine2)
    return float(np.sqrt(square)) if square > 0 else float("nan")


@dataclass(frozen=True)
class FocalEstimate:
    """Estimate of the focal length. ``focal_px``: geometric mean of both axes. ``sigma_px``: σ of this mean, from the
    scatter between frames, because pairs of one frame share stars. ``erlank_px``: the small-angle form D/θ for the same
    pairs. Per pair: ``values_px``, ``radius_px`` of the star farther from the centre."""

    focal_px: float
    sigma_px: float
    erlank_px: float
    pairs: int
    frames: int
    values_px: Array
    radius_px: Array
    warnings: tuple[Advice, ...]


def focal_from_pairs(frames: Sequence[FrameStars], camera: Camera, *, radius_px: float | None = None) -> FocalEstimate:
    """Estimate from pairs of stars of each frame within ``radius_px`` of the camera's centre (half-way to the corner by
    default), where distortion and tilt have the least effect. Pairs with larger separation have more weight."""
    aspect = camera.focal_col_px / camera.focal_row_px
    stretch = np.array([aspect**-0.5, aspect**0.5])
    centre = np.array([camera.centre_col_px, camera.centre_row_px])
    reach = NEAR_CENTRE * float(np.hypot(camera.columns, camera.rows)) / 2 if radius_px is None else radius_px
    estimates: list[tuple[float, float, float, float, float]] = []
    per_frame: list[float] = []
    for frame in frames:
        offset = (frame.pixels - centre) * stretch
        radius = np.hypot(offset[:, 0], offset[:, 1])
        frame_pairs = _pairs(offset, frame.icrs, radius, reach)
        if frame_pairs:
            values = np.array(frame_pairs)
            per_frame.append(float(np.average(values[:, 0], weights=values[:, 1] ** 2)))
            estimates += frame_pairs
    if len(estimates) < MIN_PAIRS:
        raise BadInput(
            "too few pairs of stars near the optical centre",
            expected=f"{MIN_PAIRS} within {reach:.0f} px of it",
            got=str(len(estimates)),
            hint="use a denser part of the sky or a larger radius",
        )
    values = np.array(estimates[:MAX_PAIRS])
    inliers = np.abs(values[:, 0] - np.median(values[:, 0])) < 5 * max(robust_sigma(values[:, 0]), 1e-9)
    weight = values[inliers, 1] ** 2
    focal = float(np.average(values[inliers, 0], weights=weight))
    erlank = float(np.average(values[inliers, 2], weights=weight))
    spread = float(np.std(per_frame, ddof=1)) / np.sqrt(len(per_frame)) if len(per_frame) > 2 else float("nan")
    return FocalEstimate(
        focal,
        float(spread),
        erlank,
        int(inliers.sum()),
        len(per_frame),
        values[:, 0],
        values[:, 3],
        tuple(_warnings(values[inliers])),
    )


def _pairs(offset: Array, icrs: Array, radius: Array, reach: float) -> list[tuple[float, float, float, float, float]]:
    near = np.flatnonzero(radius < reach)
    estimates = []
    for i, a in enumerate(near.tolist()):
        for b in near[i + 1 :].tolist():
            length = float(np.hypot(*(offset[a] - offset[b])))
            if length < SHORTEST * reach:
                continue
            true = float(separation_rad(icrs[a], icrs[b]))
            f = focal_from_pair(offset[a], offset[b], true)
            if np.isfinite(f):
                estimates.append((f, length, length / true, float(max(radius[a], radius[b])), true))
    return estimates


def _warnings(values: Array) -> list[Advice]:
    """Return warnings; a focal length that changes with the radius indicates distortion."""
    if len(values) < 12:
        return []
    order = np.argsort(values[:, 3])
    inner, outer = values[order[: len(order) // 3], 0], values[order[-len(order) // 3 :], 0]
    change = float(np.median(outer) / np.median(inner) - 1)
    error = (
        1.25 * float(np.hypot(robust_sigma(inner), robust_sigma(outer))) / float(np.sqrt(len(inner)) * np.median(inner))
    )
    if abs(change) < max(3 * error, 1e-3):
        return []
    text = f"the focal length changes by {change:+.2%} from the middle to the edge"
    return [Advice("distortion", text, "use a smaller radius, or self-calibration, which also fits the distortion")]
